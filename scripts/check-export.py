#!/usr/bin/env python3
"""Compares exported models with what OpenCV and ONNX Runtime make of them.

    python scripts/check-export.py MODEL IMAGE [--out DIR]

MODEL is anything `tcross infer` takes. The model is written as Darknet and ONNX files, once as it is (`exact`) and once with
batch norm folded (`folded`); OpenCV's readNetFromDarknet and ONNX Runtime run them on the letterboxed image, and heads and
detections must equal ours: ONNX heads to 1e-4 of the largest value (at least 1), OpenCV's detections to 0.5 px and 0.002.
Needs: numpy, onnx, onnxruntime, opencv-python-headless<5. The last line is `ok`, or the program ends with an error.
"""
import argparse
import json
import os
import subprocess
import sys
import tempfile

import cv2
import numpy as np
import onnx
import onnxruntime

SCORE, NMS = 0.25, 0.45  # OpenCV itself drops what is below 0.2


def onnx_heads(path, x):
    onnx.checker.check_model(path, full_check=True)
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [o.name for o in session.get_outputs()]
    twice = session.run(names, {"images": np.concatenate([x, x])})  # the batch is free
    return {n: y[:1] for n, y in zip(names, twice)}


def opencv_rows(cfg, weights, x):
    """Rows of OpenCV's region layers: cx, cy, w, h (fractions), objectness, objectness * class each (0 where small)."""
    net = cv2.dnn.readNetFromDarknet(cfg, weights)
    net.setInput(x)
    return np.concatenate([y.reshape(-1, y.shape[-1]) for y in net.forward(net.getUnconnectedOutLayersNames())])


def detections_of(rows, net, source):
    """The same letterbox, threshold and suppression as ours, in plain Python."""
    (nw, nh), (sw, sh) = net, source
    w, h = (nw, sh * nw // sw) if nw * sh < nh * sw else (sw * nh // sh, nh)
    found = []
    for r in rows:
        for k in np.flatnonzero(r[5:] >= SCORE):
            cx, cy = (r[0] * nw - (nw - w) / 2) * sw / w, (r[1] * nh - (nh - h) / 2) * sh / h
            bw, bh = r[2] * nw * sw / w, r[3] * nh * sh / h
            found.append((float(r[5 + k]), int(k), [cx - bw / 2, cy - bh / 2, cx + bw / 2, cy + bh / 2]))
    kept = []
    for d in sorted(found, key=lambda d: -d[0]):
        if all(k[1] != d[1] or iou(k[2], d[2]) <= NMS for k in kept):
            kept.append(d)
    return kept


def iou(a, b):
    w, h = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
    both = max(w, 0) * max(h, 0)
    return both / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - both)


def compare(ours, theirs):
    """Largest difference of score and of box, pairing each of ours with the nearest of its class that is left."""
    assert len(ours) == len(theirs), f"{len(ours)} detections here, {len(theirs)} there"
    left, score, px = list(theirs), 0.0, 0.0
    for d in ours:
        near = [(max(abs(p - q) for p, q in zip(d["box"], t[2])), t) for t in left if t[1] == d["class"]]
        assert near, f"no detection of class {d['class']} there"
        box, t = min(near, key=lambda n: n[0])
        left.remove(t)
        score, px = max(score, abs(d["score"] - t[0])), max(px, box)
    return score, px


def main():
    ap = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ap.add_argument("model")
    ap.add_argument("image")
    ap.add_argument("--out", help="keep the files here")
    a = ap.parse_args()
    out = a.out or tempfile.mkdtemp()
    # Built together with the program, so that the framework is not compiled a second time with other features.
    subprocess.run(["cargo", "build", "--release", "--quiet", "-p", "tcross", "-p", "tcross-yolo", "--example", "export_reference"], check=True)
    target = os.environ.get("CARGO_TARGET_DIR", os.path.join(os.path.dirname(__file__), "..", "target"))
    subprocess.run([os.path.join(target, "release", "examples", "export_reference"), a.model, a.image, out], check=True)
    x = np.load(os.path.join(out, "input.npy"))
    ours = json.loads(open(os.path.join(out, "detections.jsonl")).readline())
    net, source = (x.shape[3], x.shape[2]), (ours["width"], ours["height"])
    bad = 0
    for name in ("exact", "folded"):
        for head, y in onnx_heads(os.path.join(out, name + ".onnx"), x).items():
            want = np.load(os.path.join(out, head + ".npy"))
            off, most = np.abs(y - want).max(), max(np.abs(want).max(), 1)
            bad += not off <= 1e-4 * most
            print(f"{name}: ONNX Runtime {head}: difference {off:.2g}, largest value {most:.3g}")
        rows = opencv_rows(os.path.join(out, name + ".cfg"), os.path.join(out, name + ".weights"), x)
        score, px = compare(ours["detections"], detections_of(rows, net, source))
        bad += not (ours["detections"] and score <= 0.002 and px <= 0.5)  # nothing detected is nothing compared
        print(f"{name}: OpenCV: {len(ours['detections'])} detections, score differs by {score:.2g}, box by {px:.2g} px")
    print("ok" if not bad else f"{bad} comparisons failed")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
