#!/bin/bash
# Written by swimid.
set -e
job=$(sbatch --parsable {{ array }})
sbatch --dependency=afterany:"$job" {{ collect }}
