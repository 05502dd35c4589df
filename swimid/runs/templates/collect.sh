#!/bin/bash
# Written by swimid. It runs after the array, and writes summary and page.
#SBATCH --job-name=swimid-collect
#SBATCH --output={{ logs }}/collect.txt
cd {{ folder }}
swimid batch {{ plan }} -o {{ run }} --collect
