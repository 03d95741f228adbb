#!/usr/bin/env python3
"""Recall and corner error of our hand-drawn marker and of a printed ArUco marker in its place, against size, tilt and blur.

Three sets are needed, made from one config and one seed, so that image k is the same scene and camera in each:
    tcross datagen configs/presets/pose-aruco.toml --backgrounds PHOTOS --seed 3 --out DIR/ours
    tcross datagen configs/presets/pose-aruco.toml --backgrounds PHOTOS --seed 3 --out DIR/empty --set data.markers.per_image=0 \
        --set data.camera.motion_blur=0 --set data.camera.defocus_px=0 --set data.camera.noise_percent=0
    cargo run --release -p tcross-infer --example pose_study -- DIR/ours --method model --out DIR/study
    python scripts/compare-aruco.py DIR --out docs/results/aruco

The ArUco marker (DICT_4X4_50, one module of white around it) is drawn into the empty twin of each scene through the marker's true
homography, side for side as large as ours, in linear light; then motion, defocus, noise and JPEG follow as they did for ours.
Corners are OpenCV's with sub-pixel refinement. Needs numpy, opencv-python-headless (4.7 or newer) and matplotlib.
"""
import argparse
import json
import pathlib

import cv2
import numpy as np

MODULES = 8  # 4x4 bits, a black border of one module and a white one around it
SUPER = 3  # samples a pixel and axis


def linear(image):
    v = image.astype(np.float32) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4).astype(np.float32)


def stored(light):
    light = np.clip(light, 0, 1)
    return np.round(255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)).astype(np.uint8)


def marker_picture(dictionary, number, pixels=50):
    """White margin included; the marker itself is 6 of 8 modules wide."""
    inner = cv2.aruco.generateImageMarker(dictionary, number, 6 * pixels)
    return cv2.copyMakeBorder(inner, pixels, pixels, pixels, pixels, cv2.BORDER_CONSTANT, value=255)


def motion_kernel(length, degrees):
    size = int(np.ceil(length)) | 1
    kernel = np.zeros((size + 2, size + 2), np.float32)
    middle = (size + 1) / 2
    for t in np.linspace(-0.5, 0.5, 16 * size):
        x, y = middle + t * length * np.cos(np.radians(degrees)), middle + t * length * np.sin(np.radians(degrees))
        i, j = int(x), int(y)
        for di, wx in ((0, 1 - (x - i)), (1, x - i)):
            for dj, wy in ((0, 1 - (y - j)), (1, y - j)):
                if j + dj < kernel.shape[0] and i + di < kernel.shape[1]:
                    kernel[j + dj, i + di] += wx * wy
    return kernel / kernel.sum()


def render(background, record, marker, dictionary, rng):
    """The scene with an ArUco marker in place of ours, and its true corners."""
    light = linear(background)
    height, width = light.shape[:2]
    number = int(rng.integers(50))
    picture = marker_picture(dictionary, number)
    size = picture.shape[0]
    unit = np.array(marker["homography"]).reshape(3, 3)
    # Picture pixels to the unit square of the marker itself: the white margin lies outside of it.
    module = size / MODULES
    to_unit = np.array([[1 / (6 * module), 0, -1 / 6], [0, 1 / (6 * module), -1 / 6], [0, 0, 1]])
    scale = np.diag([SUPER, SUPER, 1.0])
    warp = scale @ unit @ to_unit
    tall, wide = height * SUPER, width * SUPER
    corners = np.array([[0, 0], [size, 0], [size, size], [0, size]], np.float32).reshape(-1, 1, 2)
    quad = cv2.perspectiveTransform(corners, unit @ to_unit).reshape(-1, 2)
    x0, y0 = np.maximum(np.floor(quad.min(0)).astype(int) - 2, 0)
    x1, y1 = np.minimum(np.ceil(quad.max(0)).astype(int) + 3, [width, height])
    if x1 <= x0 or y1 <= y0:
        return None
    shift = np.array([[1, 0, -x0 * SUPER], [0, 1, -y0 * SUPER], [0, 0, 1.0]])
    # warpPerspective counts from pixel centres, we from their corners.
    half = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    matrix = half @ shift @ warp @ np.linalg.inv(half)
    out = ((x1 - x0) * SUPER, (y1 - y0) * SUPER)
    ink = cv2.warpPerspective(picture.astype(np.float32) / 255, matrix, out, flags=cv2.INTER_LINEAR)
    cover = cv2.warpPerspective(np.ones_like(picture, np.float32), matrix, out, flags=cv2.INTER_LINEAR)
    small = (x1 - x0, y1 - y0)
    ink, cover = (cv2.resize(v, small, interpolation=cv2.INTER_AREA) for v in (ink, cover))
    # Paper in the scene's light: as bright as the generator's sheets are on average.
    level = float(np.clip(1.7 * light.mean() + 0.12, 0.08, 1.05))
    own = (0.03 + 0.82 * ink) * level
    patch = light[y0:y1, x0:x1]
    light[y0:y1, x0:x1] = patch * (1 - cover[..., None]) + own[..., None] * cover[..., None]
    effects = record["effects"]
    blur = effects.get("motion")
    if blur and blur["length_px"] > 0.3:
        light = cv2.filter2D(light, -1, motion_kernel(blur["length_px"], blur["angle_deg"]))
    softness = np.hypot(effects.get("defocus_px", 0) / 2, 0.6)
    light = cv2.GaussianBlur(light, (0, 0), softness)
    percent = effects.get("noise_percent", 0) / 100
    if percent > 0:
        deviation = np.sqrt((percent**2) * np.clip(light, 0, 1) + (percent / 10) ** 2)
        light = light + deviation * rng.standard_normal(light.shape).astype(np.float32)
    coded = cv2.imencode(".jpg", stored(light), [cv2.IMWRITE_JPEG_QUALITY, int(effects.get("jpeg_quality", 92))])[1]
    true = cv2.perspectiveTransform(np.array([[[0, 0]], [[1, 0]], [[1, 1]], [[0, 1]]], np.float32), unit).reshape(-1, 2)
    return cv2.imdecode(coded, cv2.IMREAD_COLOR), true, number


def side_of(corners):
    x, y = np.array(corners).T
    return np.sqrt(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def error_percent(found, true):
    return 100 * np.sqrt(((np.array(found) - np.array(true)) ** 2).sum(1).mean()) / side_of(true)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dir", type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("aruco"))
    parser.add_argument("--limit", type=int, help="only the first so many scenes")
    args = parser.parse_args()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(dictionary, settings)
    truth = [json.loads(line) for line in open(args.dir / "study/truth.jsonl")][: args.limit]
    ours = {row["image"]: row for row in map(json.loads, open(args.dir / "study/model.jsonl"))}
    rows = []
    for index, record in enumerate(truth):
        rng = np.random.default_rng(index)
        background = cv2.imread(str(args.dir / "empty" / record["image"]))
        for marker, detection in zip(record["markers"], ours[record["image"]]["detections"]):
            made = render(background, record, marker, dictionary, rng)
            if made is None:
                continue
            image, true, number = made
            found, numbers, _ = detector.detectMarkers(image)
            # OpenCV counts from the first pixel's centre.
            hits = [f.reshape(4, 2) + 0.5 for f, n in zip(found, [] if numbers is None else numbers.ravel()) if n == number]
            aruco = min((error_percent(h, true) for h in hits), default=None)
            pose = detection["pose"]
            mine = error_percent(pose["corners"], marker["corners"]) if "corners" in pose else None
            side = side_of(marker["corners"])
            rows.append((side, marker["tilt_deg"], 100 * marker.get("blur_px", 0) / side, mine, aruco))
    args.out.parent.mkdir(parents=True, exist_ok=True)
    limit = 25  # a corner error beyond a quarter of the side is no recovered pose
    print(f"{len(rows)} scenes; recovered: within {limit} % of the side")
    figure(rows, limit, args.out)


def figure(rows, limit, out):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    factors = [
        ("side (px)", 0, [40, 60, 90, 135, 200, 300, 400]),
        ("tilt (degrees)", 1, [0, 10, 20, 30, 40, 50, 60]),
        ("motion blur (% of the side)", 2, [0, 0.01, 5, 10, 15, 20, 30]),
    ]
    fig, axes = plt.subplots(2, 3, figsize=(11, 6), sharey="row")
    for column, (label, key, edges) in enumerate(factors):
        print(f"\n| {label} | scenes | ours: recall, median corner error | ArUco: recall, median corner error |\n|---|---|---|---|")
        lines = {"ours, drawn by hand": ([], [], []), "ArUco, printed": ([], [], [])}
        for low, high in zip(edges, edges[1:]):
            inside = [r for r in rows if low <= r[key] < high]
            if not inside:
                continue
            cells = []
            for (name, (xs, recalls, errors)), which in zip(lines.items(), (3, 4)):
                good = [r[which] for r in inside if r[which] is not None and r[which] < limit]
                xs.append(np.mean([r[key] for r in inside]))
                recalls.append(100 * len(good) / len(inside))
                errors.append(np.median(good) if good else np.nan)
                cells.append(f"{recalls[-1]:.1f} %, {errors[-1]:.2f} %")
            print(f"| {low:g} to {high:g} | {len(inside)} | {cells[0]} | {cells[1]} |")
        for (name, (xs, recalls, errors)), style in zip(lines.items(), ("o-", "s--")):
            axes[0, column].plot(xs, recalls, style, label=name)
            axes[1, column].plot(xs, errors, style, label=name)
        axes[1, column].set_xlabel(label)
    axes[0, 0].set_ylabel("recall (%)")
    axes[1, 0].set_ylabel("median corner error (% of the side)")
    axes[0, 0].set_ylim(0, 104)
    axes[1, 0].set_ylim(bottom=0)
    axes[0, 0].legend(loc="lower right")
    for axis in axes.ravel():
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
    fig.tight_layout()
    for ending in ("svg", "png"):
        fig.savefig(out.with_suffix(f".{ending}"), dpi=130)


if __name__ == "__main__":
    main()
