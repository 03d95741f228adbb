#!/bin/bash
# A dataset as an array of jobs: `sbatch --array=0-15 scripts/datagen-slurm.sh CONFIG OUT [BACKGROUNDS]`.
# Each job makes one shard in OUT/shard-I. A failed or killed shard alone is run again with
# `sbatch --array=I scripts/datagen-slurm.sh CONFIG OUT` (with SHARDS=16 if the new array is shorter); it resumes where it stopped.
# When all are there: `tcross dataset merge OUT/shard-* --out OUT/all` and `tcross dataset verify OUT/all`.
#SBATCH --job-name=tcross-datagen
#SBATCH --cpus-per-task=4
#SBATCH --time=02:00:00
set -euo pipefail
config=$1 out=$2 backgrounds=${3:-}
shards=${SHARDS:-${SLURM_ARRAY_TASK_COUNT:?run me with sbatch --array}}
tcross datagen "$config" --out "$out/shard-$SLURM_ARRAY_TASK_ID" --shard "$SLURM_ARRAY_TASK_ID/$shards" --resume \
    --threads "${SLURM_CPUS_PER_TASK:-4}" ${backgrounds:+--backgrounds "$backgrounds"}
