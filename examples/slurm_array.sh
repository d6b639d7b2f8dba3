#!/bin/bash
# One run shared out over an array of SLURM jobs: sbatch examples/slurm_array.sh plans.json results
# Each job may be stopped and started again. When all are through: petmjx merge results/shard-* --out results/all
#SBATCH --job-name=petmjx
#SBATCH --array=1-20
#SBATCH --cpus-per-task=8
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --signal=TERM@60
set -euo pipefail

plans=$1
results=$2
shards=${SHARDS:-${SLURM_ARRAY_TASK_COUNT:?start it with sbatch}} # SHARDS=20 to start one of 20 again

# On GPUs: #SBATCH --gpus=1, and --engine mjx-warp without --threads
exec petmjx score "$plans" --engine mujoco --threads "$SLURM_CPUS_PER_TASK" \
    --shard "$SLURM_ARRAY_TASK_ID/$shards" --out "$results/shard-$SLURM_ARRAY_TASK_ID" --resume
