#!/usr/bin/env python3
"""Times one image through T-cross, ONNX Runtime, OpenCV's Darknet importer and PyTorch, taking turns in one run.

    cargo build --release -p tcross-yolo -p tcross --examples
    python3 scripts/bench-infer.py [--rounds 30] [--threads 2] [--only yolov3-tiny,0.25]

Needs `pip install torch onnx onnxruntime "opencv-python-headless<5"`; a peer that is not installed is left out, with a line saying so.
Networks and input are identical (416 x 416, 80 classes); every engine folds batch norm itself. OpenCV's time includes its box decoding,
which cannot be taken out. Each contender has a process of its own and waits while another runs; a turn is a short burst of images, as in a
video. Prints medians and the least time: on a
machine that does other work the least says more. T-cross's load is that of its own file: read, batch norm folded, weights arranged.
"""
import argparse, glob, os, statistics, subprocess, sys, tempfile, time

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(HERE)
CASES = [("yolov3-tiny", "tiny", 1.0), ("yolov3", "full", 0.25), ("yolov3", "full", 1.0)]


def serve(run):
    print("ready 0", flush=True)
    for line in sys.stdin:
        if line.strip() == "end":
            break
        start = time.perf_counter()
        run()
        print(f"{time.perf_counter() - start:.6f}", flush=True)


def worker(engine, name, width, threads, scratch):
    import numpy as np
    x = np.random.default_rng(0).random((1, 3, 416, 416), dtype=np.float32)
    if engine == "opencv":
        import cv2
        cv2.setNumThreads(threads)
        net = cv2.dnn.readNetFromDarknet(f"{scratch}/model.cfg", f"{scratch}/model.weights")
        outputs = net.getUnconnectedOutLayersNames()
        return serve(lambda: (net.setInput(x), net.forward(outputs)))
    import torch
    sys.path.insert(0, os.path.join(HERE, "peers"))
    from yolov3_torch import build
    torch.set_num_threads(threads)
    model, t = build(name, width).eval(), torch.from_numpy(x)
    if engine == "onnxruntime":
        import onnxruntime
        path = os.path.join(scratch, f"{name}-{width}.onnx")
        with torch.no_grad():
            torch.onnx.export(model, (t,), path, opset_version=13, dynamo=False, input_names=["x"])
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        return serve(lambda: session.run(None, {"x": x}))
    model, t = model.to(memory_format=torch.channels_last), t.to(memory_format=torch.channels_last)
    with torch.inference_mode():
        serve(lambda: model(t))


def cpu_seconds(pid):
    """Time that all threads of a process have run: what a machine that does other work does not change much. (With one thread; peers
    with several spin while they wait.)"""
    return sum(int(open(f).read().split()[0]) for f in glob.glob(f"/proc/{pid}/task/*/schedstat")) / 1e9


class Contender:
    def __init__(self, name, command, env):
        self.name, self.times, self.cpu = name, [], []
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
        line = "x"
        while line and not line.startswith("ready"):
            line = self.process.stdout.readline()
        self.alive, self.words = bool(line), line.split()
        if not self.alive:
            print(f"  {name} is left out: {self.process.stderr.read().strip().splitlines()[-1:]}")

    def step(self):
        before = cpu_seconds(self.process.pid)
        self.process.stdin.write("go\n")
        self.process.stdin.flush()
        seconds = float(self.process.stdout.readline())
        self.cpu.append(cpu_seconds(self.process.pid) - before)
        return seconds


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument("--burst", type=int, default=6, help="images a turn, of which the first does not count")
    parser.add_argument("--only", help="architectures or widths, by commas")
    parser.add_argument("--peak", type=float, default=204.0, help="multiply-add peak of all threads, GFLOP/s")
    parser.add_argument("--worker", nargs=4)
    args = parser.parse_args()
    if args.worker:
        engine, name, width, scratch = args.worker
        return worker(engine, name, float(width), args.threads, scratch)
    env = {**os.environ, "OMP_NUM_THREADS": str(args.threads), "RAYON_NUM_THREADS": str(args.threads)}
    for architecture, peer, width in CASES:
        if args.only and not {architecture, str(width)} & set(args.only.split(",")):
            continue
        with tempfile.TemporaryDirectory() as scratch:
            # The Darknet files of the very network that T-cross runs.
            ours = os.path.join(ROOT, "target/release/examples")
            subprocess.run([f"{ours}/export_darknet", architecture, str(width), scratch], check=True)
            me = [sys.executable, __file__, "--threads", str(args.threads), "--worker"]
            contenders = [Contender("T-cross", [f"{ours}/bench_frame", architecture, str(width)], env)]
            contenders += [Contender(engine, [*me, engine, peer, str(width), scratch], env) for engine in ("onnxruntime", "opencv", "torch")]
            contenders = [c for c in contenders if c.alive]
            for c in contenders * 3:
                c.step()
            for _ in range(args.rounds):
                for c in contenders:
                    # The threads of the peer before still spin for a while and hold the cores.
                    time.sleep(0.2)
                    c.step()
                    c.times += [c.step() for _ in range(args.burst - 1)]
            mine = statistics.median(contenders[0].times)
            flops, load, read = map(float, contenders[0].words[1:4])
            print(f"{architecture} x {width}, {args.threads} threads: floor {flops / args.peak / 1e6:.1f} ms; "
                  f"T-cross loads in {1e3 * load:.0f} ms, of which reading the file takes {1e3 * read:.0f}")
            for c in contenders:
                c.process.communicate("end\n")
                t = statistics.median(c.times)
                print(f"  {c.name:14} {1e3 * t:8.1f} ms, at least {1e3 * min(c.times):7.1f}  T-cross is x{t / mine:4.2f} as fast, "
                      f"by least times x{min(c.times) / min(contenders[0].times):4.2f}, "
                      f"by CPU time ({1e3 * min(c.cpu[3:]):.1f} ms) x{min(c.cpu[3:]) / min(contenders[0].cpu[3:]):4.2f}", flush=True)


if __name__ == "__main__":
    main()
