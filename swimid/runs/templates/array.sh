#!/bin/bash
# Written by swimid. Submit both scripts with: bash {{ submit }}
#SBATCH --job-name=swimid
#SBATCH --array=1-{{ jobs }}
#SBATCH --cpus-per-task=1
#SBATCH --requeue
#SBATCH --output={{ logs }}/%A_%a.txt
set -e
cd {{ folder }}
# Exit status 4 says that an item was refused or failed, which the summary shows.
swimid batch {{ plan }} -o {{ run }} --shard "$SLURM_ARRAY_TASK_ID/{{ jobs }}" --jobs 1{{ retry }} || [ $? -eq 4 ]
