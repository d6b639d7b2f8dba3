#!/bin/bash
# Divides one run among the jobs of a SLURM array: sbatch examples/slurm_array.sh plans.json results
# Each job may be stopped and started again. When all jobs have finished: petmjx merge results/shard-* --out results/all
#SBATCH --job-name=petmjx
#SBATCH --array=1-20
#SBATCH --cpus-per-task=8
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --signal=TERM@60
set -euo pipefail

plans=$1
results=$2
shards=${SHARDS:-${SLURM_ARRAY_TASK_COUNT:?start it with sbatch}} # set SHARDS=20 to start one of 20 jobs again

# On GPUs: add #SBATCH --gpus=1, and use --engine mjx-warp without --threads
exec petmjx score "$plans" --engine mujoco --threads "$SLURM_CPUS_PER_TASK" \
    --shard "$SLURM_ARRAY_TASK_ID/$shards" --out "$results/shard-$SLURM_ARRAY_TASK_ID" --resume
