#!/usr/bin/env python3
"""Holds our COCO numbers against pycocotools, on random and on degenerate input, and times both.

    pip install pycocotools numpy
    cargo build --release -p tcross-eval --example coco_scores
    python3 scripts/compare-coco.py [--time IMAGES]

Every one of COCO's twelve numbers must agree to 1e-9, and be undefined on both sides alike; else the script exits with 1.
With --time it also prints how long evaluate + accumulate take on IMAGES images of 100 detections and 80 categories.
Its last output is recorded in docs/results/compare-coco.txt.
"""
import contextlib
import io
import json
import pathlib
import subprocess
import sys
import tempfile
import time

import numpy as np
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = ROOT / "target/release/examples/coco_scores"
KEYS = "ap ap50 ap75 ap_small ap_medium ap_large ar1 ar10 ar100 ar_small ar_medium ar_large".split()


def truth(id, image, category, box, crowd=0, area=None):
    area = box[2] * box[3] if area is None else area
    return dict(id=id, image_id=image, category_id=category, bbox=[float(v) for v in box], area=float(area), iscrowd=crowd)


def claim(image, category, box, score):
    return dict(image_id=image, category_id=category, bbox=[float(v) for v in box], score=float(score))


def dataset(images, categories, annotations):
    return dict(info={}, images=[dict(id=i, width=640, height=640) for i in images],
                categories=[dict(id=c, name=str(c)) for c in categories], annotations=annotations)


def random_case(seed, images=60, categories=3, truths=8, claims=30, ties=False, crowds=False, side=(5, 200)):
    r = np.random.default_rng(seed)
    g, d = [], []
    for i in range(1, images + 1):
        n = int(r.integers(0, truths + 1))
        boxes = [[*r.uniform(0, 400, 2), *r.uniform(*side, 2)] for _ in range(n)]
        cats = r.integers(1, categories + 1, n)
        for b, c in zip(boxes, cats):
            g.append(truth(len(g) + 1, i, int(c), b, int(crowds and r.random() < 0.15)))
        for _ in range(int(r.integers(0, claims + 1))):
            if n and r.random() < 0.6:
                k = int(r.integers(0, n))
                b, c = np.array(boxes[k]), int(cats[k])
                b = np.concatenate([b[:2] + r.normal(0, 0.12 * b[2:]), b[2:] * r.uniform(0.8, 1.25, 2)])
            else:
                b, c = [*r.uniform(0, 400, 2), *r.uniform(*side, 2)], int(r.integers(1, categories + 1))
            score = r.integers(0, 5) / 5 if ties else r.random()
            d.append(claim(i, c, b, score))
    return dataset(range(1, images + 1), range(1, categories + 1), g), d


def cases():
    for seed in range(20):
        yield f"random {seed}", *random_case(seed)
        yield f"ties {seed}", *random_case(100 + seed, ties=True)
        yield f"crowds {seed}", *random_case(200 + seed, crowds=True, ties=seed % 2 == 0)
        yield f"small boxes {seed}", *random_case(300 + seed, side=(0, 40), ties=True)
    one = [truth(1, 1, 1, [10, 10, 50, 50])]
    yield "no detections", dataset([1, 2], [1], one), []
    yield "no truth", dataset([1, 2], [1], []), [claim(1, 1, [10, 10, 50, 50], 0.5)]
    yield "neither", dataset([1], [1], []), []
    yield "a perfect detection", dataset([1], [1], one), [claim(1, 1, [10, 10, 50, 50], 1)]
    yield "a category without truth", dataset([1], [1, 2], one), [claim(1, 2, [10, 10, 50, 50], 1)]
    yield "an unknown category", dataset([1], [1], one), [claim(1, 7, [10, 10, 50, 50], 1)]
    yield "five hundred duplicates", dataset([1], [1], one), [claim(1, 1, [10, 10, 50, 50], 0.5)] * 500
    yield "only crowds", dataset([1], [1], [truth(1, 1, 1, [10, 10, 50, 50], 1)]), [claim(1, 1, [12, 12, 9, 9], 0.5)] * 5
    point = [truth(1, 1, 1, [10, 10, 0, 0]), truth(2, 1, 1, [30, 30, 0, 20])]
    yield "boxes of no area", dataset([1], [1], point), [claim(1, 1, [10, 10, 0, 0], 0.5), claim(1, 1, [30, 30, 0, 20], 0.4)]
    edge = [truth(1, 1, 1, [0, 0, 32, 32]), truth(2, 1, 1, [100, 100, 96, 96])]
    yield "areas on the edges", dataset([1], [1], edge), [claim(1, 1, [0, 0, 32, 32], 0.5), claim(1, 1, [100, 100, 96, 96], 0.5)]
    half = [truth(1, 1, 1, [0, 0, 100, 100])]
    for k in range(50, 100, 5):
        yield f"IoU of exactly {k} %", dataset([1], [1], half), [claim(1, 1, [0, 0, k, 100], 0.5)]
    yield "images out of order", dataset([9, 2, 5], [3, 1], [truth(1, 9, 3, [0, 0, 40, 40]), truth(2, 2, 1, [5, 5, 40, 40])]), [
        claim(2, 1, [5, 5, 40, 40], 0.5), claim(9, 3, [1, 1, 40, 40], 0.5), claim(5, 1, [1, 1, 40, 40], 0.5)]


def theirs(instances, results):
    with contextlib.redirect_stdout(io.StringIO()):
        gt = COCO()
        gt.dataset = json.loads(json.dumps(instances))
        gt.createIndex()
        if results:
            dt = gt.loadRes(json.loads(json.dumps(results)))
        else:  # loadRes does not take an empty list
            dt = COCO()
            dt.dataset = dict(instances, annotations=[])
            dt.createIndex()
        e = COCOeval(gt, dt, "bbox")
        start = time.perf_counter()
        e.evaluate()
        e.accumulate()
        seconds = time.perf_counter() - start
        e.summarize()
    return {k: v for k, v in zip(KEYS, e.stats) if v > -1}, seconds


def ours(instances, results):
    with tempfile.TemporaryDirectory() as folder:
        paths = [pathlib.Path(folder) / name for name in ("truth.json", "results.json")]
        for path, content in zip(paths, (instances, results)):
            path.write_text(json.dumps(content))
        out = json.loads(subprocess.run([PROGRAM, *paths], check=True, capture_output=True, text=True).stdout)
    return out["scores"], out["score_s"]


def main():
    worst, wrong, number = 0.0, 0, 0
    for name, instances, results in cases():
        number += 1
        a, b = theirs(instances, results)[0], ours(instances, results)[0]
        if a.keys() != b.keys():
            wrong += 1
            print(f"{name}: defined by pycocotools {sorted(a)}, by us {sorted(b)}")
            continue
        difference = max((abs(a[k] - b[k]) for k in a), default=0.0)
        worst = max(worst, difference)
        if difference > 1e-9:
            wrong += 1
            print(f"{name}: differs by {difference:.3g}: {a} {b}")
    print(f"{number} cases, {wrong} disagree, largest difference {worst:.3g}")
    if "--time" in sys.argv:
        images = int(sys.argv[sys.argv.index("--time") + 1])
        instances, results = random_case(0, images, 80, 16, 200)
        (a, slow), (b, fast) = theirs(instances, results), ours(instances, results)
        print(f"{images} images, {len(results)} detections: pycocotools {slow:.2f} s, ours {fast:.3f} s, {slow / fast:.0f} times faster; "
              f"AP {a['ap']:.6f} and {b['ap']:.6f}")
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
