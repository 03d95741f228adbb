#!/bin/sh
# Recall against CPU minutes of yolov3-tiny: from scratch, from the COCO weights with the backbone frozen, and with everything learning.
#
#   scripts/finetune-tiny.sh yolov3-tiny.weights OUT [BACKGROUNDS]
#
# Seeds, data and schedule are the same for all; CPU minutes are user plus system time of the whole command, split evenly over its steps, so that
# other work on the machine does not count. OUT/table.md holds the table. TCROSS names another program than the one built here.
set -eu
weights=$1 out=$2 backgrounds=${3:-}
root=$(dirname "$0")/..
tcross=${TCROSS:-$root/target/release/tcross}
config=$root/configs/finetune-tiny.toml
mkdir -p "$out"
[ -d "$out/data" ] || "$tcross" datagen "$config" --out "$out/data" ${backgrounds:+--backgrounds "$backgrounds"}

run() { # NAME [--set KEY=VALUE]...
    name=$1
    shift
    [ -f "$out/$name.cpu" ] && return
    rm -rf "$out/$name"
    # `times` tells the children's user and system time; a shell of its own has one child only.
    sh -c '"$@" && times' - "$tcross" train "$config" --data "$out/data" --out "$out/$name" --quiet "$@" | tail -1 |
        awk '{ for (k = 1; k <= 2; k++) { split($k, t, /[ms]/); s += 60 * t[1] + t[2] } } END { if (s == 0) exit 1; print s }' >"$out/$name.part"
    # A training that failed has no times, and is not taken for done.
    mv "$out/$name.part" "$out/$name.cpu"
}
run frozen --set train.freeze=backbone --set train.init="$weights"
run scratch
run all-learning --set train.init="$weights"

{
    echo "| start | CPU min a 1000 steps | CPU min to recall 0.3 | 0.4 | 0.5 | 0.6 | best recall | best AP |"
    echo "|---|--:|--:|--:|--:|--:|--:|--:|"
    for name in scratch frozen all-learning; do
        awk -F, -v name="$name" -v cpu="$(cat "$out/$name.cpu")" '
            NR == 1 { for (k = 1; k <= NF; k++) column[$k] = k; next }
            { rows++; step[rows] = $column["step"]; recall[rows] = $column["val_recall"] + 0; ap[rows] = $column["val_ap"] + 0 }
            END {
                a = step[rows]
                line = sprintf("| %s | %.2f", name, cpu / 60 / a * 1000)
                split("0.3 0.4 0.5 0.6", wanted, " ")
                for (w = 1; w <= 4; w++) {
                    cell = "not reached"
                    for (k = rows; k >= 1; k--) if (recall[k] >= wanted[w]) cell = sprintf("%.1f", cpu / 60 / a * step[k])
                    line = line " | " cell
                }
                for (k = 1; k <= rows; k++) { if (recall[k] > r) r = recall[k]; if (ap[k] > p) p = ap[k] }
                printf "%s | %.3f | %.3f |\n", line, r, p
            }' "$out/$name/metrics.csv"
    done
} >"$out/table.md"
cat "$out/table.md"
