#!/usr/bin/env python3
"""Two trained networks on every one-factor sweep, in one table: which of two training sets makes the better detector?

    python3 scripts/compare-sweeps.py RUN_A RUN_B --out DIR [--images 300] [--backgrounds PHOTOS] [--names paper-exact,hand-drawn]

For each configs/presets/sweep-*.toml: `tcross datagen`, all images dealt to test, `tcross infer` with each run, `tcross eval` of each.
What is there already is kept, so that a stopped run goes on. Prints Markdown and writes it to DIR/sweeps.md, with AP50 and the paper's
mean IoU, precision and recall at the score threshold 0.3, and says on how many sweeps B is ahead of A.
"""
import argparse, json, pathlib, subprocess, sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
METRICS = ["AP50", "mean IoU", "precision", "recall"]


def tcross(program, *words):
    done = subprocess.run([program, *map(str, words), "--quiet"], cwd=ROOT, text=True, capture_output=True)
    if done.returncode != 0:
        sys.exit(f"tcross {' '.join(map(str, words))}\n{done.stderr}")


def scores(metrics):
    row = min(metrics["paper"]["rows"], key=lambda r: abs(r["threshold"] - 0.3))
    return dict(zip(METRICS, [metrics["coco"].get("ap50"), row.get("mean_iou"), row.get("precision"), row.get("recall")]))


def shown(value):
    return "-" if value is None else f"{value:.3f}"


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("runs", nargs=2, type=pathlib.Path)
    words.add_argument("--out", type=pathlib.Path, required=True)
    words.add_argument("--images", type=int, default=300, help="images a sweep")
    words.add_argument("--backgrounds", type=pathlib.Path)
    words.add_argument("--names", default="A,B")
    words.add_argument("--threads", type=int, default=2)
    words.add_argument("--program", default=str(ROOT / "target/release/tcross"))
    args = words.parse_args()
    names, runs, out = args.names.split(","), [r.resolve() for r in args.runs], args.out.resolve()
    photos = ["--backgrounds", args.backgrounds.resolve()] if args.backgrounds else []
    rows = []
    for preset in sorted((ROOT / "configs/presets").glob("sweep-*.toml")):
        here = out / preset.stem
        data, all_test = here / "data", here / "test"
        if not (data / "dataset.toml").is_file():
            tcross(args.program, "datagen", preset, "--out", data, "--images", args.images, "--threads", args.threads, "--resume", *photos)
        if not (all_test / "dataset.toml").is_file():
            tcross(args.program, "dataset", "split", data, "--parts", "0:0:1", "--out", all_test)
        found = []
        for name, run in zip(names, runs):
            detections, report = here / f"{name}.jsonl", here / f"eval-{name}"
            if not detections.is_file():
                tcross(args.program, "infer", run, all_test, "--split", "test", "--out", detections, "--threads", args.threads)
            tcross(args.program, "eval", all_test, detections, "--protocol", "paper,coco", "--out", report)
            found.append(scores(json.loads((report / "metrics.json").read_text())))
        rows.append((preset.stem.removeprefix("sweep-"), found))
        print(f"{preset.stem}: done", file=sys.stderr)
    heads = [f"{metric} {name}" for metric in METRICS for name in names]
    lines = ["| sweep | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
    for sweep, found in rows:
        cells = []
        for metric in METRICS:
            pair = [f[metric] for f in found]
            best = max((v for v in pair if v is not None), default=None)
            cells += [f"**{shown(v)}**" if v is not None and v == best and pair[0] != pair[1] else shown(v) for v in pair]
        lines.append(f"| {sweep} | " + " | ".join(cells) + " |")
    for metric in METRICS:
        ahead = sum((b[metric] or 0) > (a[metric] or 0) for _, (a, b) in rows)
        lines.append(f"\n{metric}: {names[1]} is ahead of {names[0]} on {ahead} of {len(rows)} sweeps.")
    text = "\n".join(lines) + "\n"
    (out / "sweeps.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
