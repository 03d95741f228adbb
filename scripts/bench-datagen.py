#!/usr/bin/env python3
"""Images a second of the generator beside a straightforward Python and OpenCV generator, taking turns in one run; or memory by image count.

    cargo build --release -p tcross
    python3 scripts/bench-datagen.py --peer ../shared/peers/gen_naive.py --photos ../shared/backgrounds [--rounds 3] [--images 600]
    python3 scripts/bench-datagen.py --memory 500,2000,8000 --photos ../shared/backgrounds

The peer's file offers `work((seed, count, photos, out))`, which makes `count` images; it runs in two processes, as T-cross runs on two
threads. Both read the same photos, and every turn writes into a new folder. T-cross's time is that of the whole program: start, a look at every photo for near-duplicates, lists,
digests. Without an idle machine compare ratios; "images per CPU second" counts the processors' time and is steadier. Memory is the most that
was resident at once, as the kernel counts it; it needs neither a peer nor an idle machine.
Needs `pip install "opencv-python-headless<5" numpy`.
"""
import argparse, importlib.util, itertools, multiprocessing, os, pathlib, resource, shutil, statistics, subprocess, sys, tempfile, time

ROOT = pathlib.Path(__file__).resolve().parent.parent
# JPEG quality of the images that the peer writes.
PEERS_QUALITY = 90


def cpu():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def timed(run):
    start, before = time.perf_counter(), cpu()
    run()
    return time.perf_counter() - start, cpu() - before


def peer(path):
    spec = importlib.util.spec_from_file_location("peer", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def tcross(program, preset, photos, out, images, threads, *more):
    words = [program, "datagen", ROOT / f"configs/presets/{preset}.toml", "--out", out, "--images", images, "--threads", threads, "--quiet", *more]
    if photos:
        words += ["--backgrounds", photos]
    child = subprocess.Popen([str(w) for w in words])
    _, status, used = os.wait4(child.pid, 0)
    if status != 0:
        sys.exit("tcross failed")
    return used.ru_maxrss / 1024


def memory(args):
    """The most resident memory of a run, by what is made and how many images."""
    counts = [int(count) for count in args.memory.split(",")]
    makes = {"hand-drawn, embedded scenes": ("hand-drawn", None), "paper-exact, photos": ("paper-exact", args.photos),
             "hand-drawn, photos": ("hand-drawn", args.photos)}
    print("| most resident memory, MiB | " + " | ".join(f"{count} images" for count in counts) + " |\n|---" + "|---:" * len(counts) + "|")
    for name, (preset, photos) in makes.items():
        print(f"| {name} ", end="", flush=True)
        for count in counts:
            with tempfile.TemporaryDirectory() as scratch:
                print(f"| {tcross(args.program, preset, photos, pathlib.Path(scratch) / 'set', count, args.threads):.0f} ", end="", flush=True)
        print("|")


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--peer", type=pathlib.Path)
    words.add_argument("--photos", type=pathlib.Path, required=True)
    words.add_argument("--rounds", type=int, default=3)
    words.add_argument("--images", type=int, default=600)
    words.add_argument("--threads", type=int, default=2)
    words.add_argument("--program", default=str(ROOT / "target/release/tcross"))
    words.add_argument("--only", help="of T-cross, those alone whose name has this in it")
    words.add_argument("--memory", help="most memory for these numbers of images, instead of speed")
    args = words.parse_args()
    if args.memory:
        return memory(args)
    if not args.peer:
        words.error("--peer is needed to compare speeds")
    photos = sorted(str(p) for p in args.photos.rglob("*.jpg"))
    naive, n = peer(args.peer), args.images
    scratch = pathlib.Path(tempfile.mkdtemp())

    turns = itertools.count()

    def run_peer():
        out = scratch / f"peer-{next(turns)}"
        out.mkdir()
        share = [(k, n // args.threads, photos, str(out)) for k in range(args.threads)]
        workers = [multiprocessing.Process(target=naive.work, args=(part,)) for part in share]
        [w.start() for w in workers]
        [w.join() for w in workers]
        if any(w.exitcode for w in workers):
            sys.exit("the peer failed")

    def run_tcross(preset, with_photos, *more):
        tcross(args.program, preset, args.photos if with_photos else None, scratch / f"ours-{next(turns)}", n, args.threads, *more)

    contenders = {
        "peer (OpenCV)": run_peer,
        "paper-exact, photos, quality 90": lambda: run_tcross("paper-exact", True, "--set", f"data.jpeg_quality={PEERS_QUALITY}"),
        "paper-exact, photos, as it is": lambda: run_tcross("paper-exact", True),
        "hand-drawn, photos": lambda: run_tcross("hand-drawn", True),
        "hand-drawn, embedded scenes": lambda: run_tcross("hand-drawn", False),
    }
    contenders = {name: run for name, run in contenders.items() if run is run_peer or not args.only or args.only in name}
    times = {name: [] for name in contenders}
    for _ in range(args.rounds):
        for name, run in contenders.items():
            times[name].append(timed(run))
    base = statistics.median(t[0] for t in times["peer (OpenCV)"])
    print(f"{n} images, {args.threads} threads, {args.rounds} rounds in turns, load {os.getloadavg()[0]:.1f}\n")
    print("| generator | images/s, median | best | images per CPU second | ratio to the peer |\n|---|---:|---:|---:|---:|")
    for name, taken in times.items():
        wall, best, used = statistics.median(t[0] for t in taken), min(t[0] for t in taken), min(t[1] for t in taken)
        print(f"| {name} | {n / wall:.1f} | {n / best:.1f} | {n / used:.1f} | {base / wall:.2f} |")
    shutil.rmtree(scratch)


if __name__ == "__main__":
    main()
