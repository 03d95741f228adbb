#!/usr/bin/env python3
"""The contact sheets of docs/pictures: one a preset, one a medium, with the credits of the photographs behind the markers.

    cargo build --release -p tcross
    python3 scripts/contact-sheets.py --photos ../shared/backgrounds [--out docs/pictures] [--only hand-drawn,medium-chalk]

PHOTOS holds `sources.csv` (file, source, photo_id, author). The sheets are written as JPEG, the credits to OUT/README.md.
"""
import argparse, csv, json, pathlib, subprocess, tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent
SWEEPS = ["blur", "light", "noise", "occlusion", "size", "tilt"]
MEDIA = ["highlighter", "felt_tip", "ball_pen", "crayon", "chalk", "paint", "dry_erase", "print"]
NEAR = {"markers.per_image": "1", "markers.side_px": '"110..230"', "markers.tilt_deg": '"0..50"', "markers.cut": "0",
        "confusers.near_misses": "0", "confusers.stickers": "0"}


def sheets():
    """Name, preset, what it is, images to make, pixels a tile, tiles a row, changes of the preset."""
    yield "hand-drawn", "hand-drawn", "`configs/presets/hand-drawn.toml`, with the truth drawn on it", 20, 200, 6, {}
    yield "hard", "hard", "`configs/presets/hard.toml`", 20, 200, 6, {}
    yield "phone-video", "phone-video", "`configs/presets/phone-video.toml`: a frame each of ten videos", 90, 260, 5, {}
    for medium in MEDIA:
        changes = NEAR | {"markers.media": f"{{ {medium} = 1 }}"}
        yield f"medium-{medium}", "hand-drawn", f"markers filled with `{medium}`", 20, 200, 6, changes
    yield "paper-exact", "paper-exact", "`configs/presets/paper-exact.toml`, the paper's own protocol", 20, 160, 6, {}
    for sweep in SWEEPS:
        what = f"`configs/presets/sweep-{sweep}.toml`: the same markers in every sweep, {sweep} as the factor"
        yield f"sweep-{sweep}", f"sweep-{sweep}", what, 20, 160, 6, {}


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--photos", type=pathlib.Path, required=True)
    words.add_argument("--out", type=pathlib.Path, default=ROOT / "docs/pictures")
    words.add_argument("--only", default="")
    words.add_argument("--ending", default="jpg")
    words.add_argument("--program", default=str(ROOT / "target/release/tcross"))
    args = words.parse_args()
    sources = {row["file"]: row for row in csv.DictReader(open(args.photos / "sources.csv"))}
    page = ["# Pictures", "", "Made by `scripts/contact-sheets.py` with seed 42; nothing was picked. Images are 416 pixels wide",
            "(`phone-video` 1280) and shown at half size or less.", ""]
    credits = {}
    for name, preset, what, images, tile, columns, changes in sheets():
        if args.only and name not in args.only.split(","):
            continue
        with tempfile.TemporaryDirectory() as scratch:
            data = pathlib.Path(scratch) / "data"
            sets = [w for key, value in changes.items() for w in ("--set", f"data.{key}={value}")]
            subprocess.run([args.program, "datagen", ROOT / f"configs/presets/{preset}.toml", "--out", data, "--backgrounds", args.photos,
                            "--images", str(images), "--seed", "42", "--quiet", "--set", "data.background.near_duplicates_together=false", *sets], check=True)
            plain = [] if name == "hand-drawn" else ["--plain"]
            subprocess.run([args.program, "dataset", "preview", data, "--split", "train", *plain, "--images", str(2 * columns),
                            "--columns", str(columns), "--tile", str(tile), "--out", args.out / f"{name}.{args.ending}", "--quiet"], check=True)
            behind = {json.loads(line)["background"] for line in open(data / "train.jsonl")}
        page += [f"{what[0].upper()}{what[1:]}:", "", f"![{what}]({name}.{args.ending})", ""]
        for photo in behind:
            row = sources.get(photo, {})
            credits[photo] = f"{row.get('author') or 'not recorded'} ({row.get('source')}, {row.get('photo_id') or row.get('path_in_source')})"
    page += ["Photographs behind the markers (Unsplash and Pexels licences, and the licences of the wallpapers' packages):", ""]
    page += [f"- {credit}" for credit in sorted(set(credits.values()))]
    if args.only:
        print("README.md is left as it is; without --only it is written with every sheet and credit")
    else:
        (args.out / "README.md").write_text("\n".join(page) + "\n")


if __name__ == "__main__":
    main()
