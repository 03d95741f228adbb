#!/usr/bin/env python3
"""Times one training step of T-cross and of PyTorch on the same networks, taking turns step by step in one run.

    cargo build --release -p tcross-train -p tcross --examples
    python3 scripts/bench-train.py [--rounds 7] [--modes nchw,channels_last,compile] [--only 0.25] [--composite]

Needs PyTorch (`pip install torch`). Every contender keeps its process and its network for the whole run; while one takes a step the others
wait. Prints medians, images a second, the ratio to each PyTorch mode, peak memory, and the arithmetic floor (three times the forward
pass's multiply-adds at the multiply-add peak, which `cargo bench -p tcross-kernels` measures; give it with --peak in GFLOP/s).
"""
import argparse, glob, os, statistics, subprocess, sys

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
CASES = [("yolov3", "full", 0.25, 8), ("yolov3", "full", 0.125, 16), ("yolov3-tiny", "tiny", 1.0, 8), ("yolov3", "full", 1.0, 1)]


def torch_worker(name, width, batch, mode, threads):
    """Runs in a process of its own: one step a line of standard input."""
    import time, torch
    sys.path.insert(0, os.path.join(HERE, "peers"))
    from yolov3_torch import build, conv_flops, fake_targets, loss_fn
    torch.set_num_threads(threads)
    torch.manual_seed(0)
    model = build(name, width).train()
    flops = conv_flops(model, 416)
    x = torch.rand(batch, 3, 416, 416)
    if mode != "nchw":
        model, x = model.to(memory_format=torch.channels_last), x.to(memory_format=torch.channels_last)
    targets = fake_targets(batch, 416, model.strides, model.nc)
    optimizer = torch.optim.SGD(model.parameters(), lr=1e-4, momentum=0.9, weight_decay=5e-4)
    run = torch.compile(model) if mode == "compile" else model
    print("ready", flops, flush=True)
    for line in sys.stdin:
        if line.strip() == "end":
            break
        start = time.perf_counter()
        loss_fn(run(x), targets, model.nc).backward()
        optimizer.step()
        optimizer.zero_grad(set_to_none=True)
        print(f"{time.perf_counter() - start:.6f}", flush=True)


def cpu_seconds(pid):
    """Time that all threads of a process have run: what a machine that does other work does not change much. (With one thread; peers
    with several spin while they wait.)"""
    return sum(int(open(f).read().split()[0]) for f in glob.glob(f"/proc/{pid}/task/*/schedstat")) / 1e9


class Contender:
    def __init__(self, name, command, env):
        self.name, self.times, self.cpu = name, [], []
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=env)
        words = self.process.stdout.readline().split()
        if not words or words[0] != "ready":
            sys.exit(f"{name} did not start: {' '.join(command)}")
        self.flops, self.empty = float(words[1]), self.memory()

    def memory(self):
        with open(f"/proc/{self.process.pid}/status") as status:
            return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))

    def step(self):
        before = cpu_seconds(self.process.pid)
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        seconds = float(self.process.stdout.readline())
        self.cpu.append(cpu_seconds(self.process.pid) - before)
        return seconds

    def end(self):
        self.peak = self.memory()
        self.process.communicate("end\n")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--modes", default="nchw,channels_last,compile")
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--only", type=float, help="only networks of this width")
    parser.add_argument("--composite", action="store_true", help="T-cross on burn's own operations as one more contender")
    parser.add_argument("--peak", type=float, default=204.0, help="multiply-add peak of all threads, GFLOP/s")
    parser.add_argument("--worker", nargs=4)
    args = parser.parse_args()
    if args.worker:
        name, width, batch, mode = args.worker
        return torch_worker(name, float(width), int(batch), mode, args.threads)
    env = {**os.environ, "OMP_NUM_THREADS": str(args.threads), "RAYON_NUM_THREADS": str(args.threads)}
    ours = os.path.join(ROOT, "target/release/examples/bench_step")
    for architecture, peer, width, batch in CASES:
        if args.only and width != args.only:
            continue
        case = [str(width), str(batch)]
        contenders = [Contender("T-cross", [ours, architecture, *case], env)]
        if args.composite:
            contenders.append(Contender("burn's own", [ours, architecture, *case, "composite"], env))
        for mode in args.modes.split(","):
            command = [sys.executable, __file__, "--threads", str(args.threads), "--worker", peer, *case, mode]
            contenders.append(Contender(f"torch {mode}", command, env))
        for _ in range(2):
            for c in contenders:
                c.step()
        for _ in range(args.rounds):
            for c in contenders:
                c.times.append(c.step())
        floor = 3 * contenders[-1].flops * batch / args.peak / 1e9
        mine = statistics.median(contenders[0].times)
        print(f"\n{architecture} x {width}, batch {batch}: floor {floor:.3f} s")
        for c in contenders:
            c.end()
            t = statistics.median(c.times)
            print(f"  {c.name:20} {t:7.3f} s  {batch / t:6.2f} images/s  x{t / floor:4.2f} of the floor  T-cross is x{t / mine:4.2f} as fast"
                  f" (least times {min(c.times):.3f} s, x{min(c.times) / min(contenders[0].times):4.2f};"
                  f" CPU time {min(c.cpu[2:]):.3f} s, x{min(c.cpu[2:]) / min(contenders[0].cpu[2:]):4.2f})"
                  f"  peak {c.peak:5.0f} MiB, {c.peak - c.empty:5.0f} above its start", flush=True)


if __name__ == "__main__":
    main()
