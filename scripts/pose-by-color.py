#!/usr/bin/env python3
"""The marks of poses by the fill's hue and saturation, from what `pose_study DATA --method model --out STUDY` leaves.

    python3 scripts/pose-by-color.py STUDY

Errors as in `pose_study`: centre and corners (root mean square of the four) in percent of the side, the square root of the marker's area;
medians and 95th percentiles over the poses that are claimed, wrong orientations (over 45 degrees) among them. Needs numpy.
"""
import colorsys, json, pathlib, sys

import numpy as np

HUES = [("red", 345, 375), ("orange, yellow", 15, 70), ("green", 70, 165), ("cyan, blue", 165, 260), ("purple, magenta", 260, 345)]
SATURATIONS = [("saturation below 0.4", 0, 0.4), ("0.4 to 0.7", 0.4, 0.7), ("0.7 and more", 0.7, 1.1)]


def trials(study):
    """Hue in degrees, saturation, and the errors of the pose (None where it is refused) of every marker."""
    lines = lambda name: [json.loads(line) for line in open(study / name)]
    found = {row["image"]: row["detections"] for row in lines("model.jsonl")}
    for record in lines("truth.jsonl"):
        for marker, detection in zip(record["markers"], found[record["image"]]):
            hue, saturation, _ = colorsys.rgb_to_hsv(*(int(marker["fill"][k : k + 2], 16) / 255 for k in (1, 3, 5)))
            yield 360 * hue, saturation, errors(detection.get("pose") or {}, marker)


def errors(pose, marker):
    if "corners" not in pose:
        return None
    true = np.array(marker["corners"])
    x, y = true.T
    side = np.sqrt(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)
    center = np.hypot(*(np.array(pose["center"]) - marker["center"]))
    corners = np.sqrt(((np.array(pose["corners"]) - true) ** 2).sum(1).mean())
    return 100 * center / side, abs((pose["angle"] - marker["angle"] + 180) % 360 - 180), 100 * corners / side


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    rows = list(trials(pathlib.Path(sys.argv[1])))
    print("| fill | markers | recovered | centre, median and p95 | angle | corners | wrong |\n|---|---|---|---|---|---|---|")
    groups = [(name, [r for r in rows if low <= r[0] < high or low <= r[0] + 360 < high]) for name, low, high in HUES]
    groups += [(name, [r for r in rows if low <= r[1] < high]) for name, low, high in SATURATIONS]
    for name, group in groups:
        claimed = np.array([r[2] for r in group if r[2]])
        if len(claimed) == 0:
            continue
        (c, a, k), (c95, a95, k95) = np.percentile(claimed, [50, 95], axis=0)
        wrong = 100 * (claimed[:, 1] > 45).mean()
        print(f"| {name} | {len(group)} | {100 * len(claimed) / len(group):.1f} % | {c:.2f} and {c95:.2f} % | {a:.2f} and {a95:.2f} "
              f"| {k:.2f} and {k95:.2f} % | {wrong:.2f} % |")


if __name__ == "__main__":
    main()
