#!/bin/sh
# Makes one tile set on the machines of a Slurm cluster, which share the folder of OUT and the sources:
#
#   docs/batch/slurm.sh SHARDS OUT [options of terrane-gen]
#
# An array of jobs makes the shards that are not complete, and a job after it merges them. If shards have failed, that job
# submits them again, at most TRIES times (3), and then names them. The environment selects partitions, times and memory
# (SBATCH_PARTITION, SBATCH_TIMELIMIT, SBATCH_MEM_PER_NODE, ...); TERRANE_GEN is the program.
set -eu
program=${TERRANE_GEN:-terrane-gen}

# Prints the numbers of the shards that are not complete, with commas.
missing() {
    "$program" "$out" "$@" --plan "$shards" | awk '
        /"complete":/ { complete = /true/ }
        /"shard":/ { split($2, part, /["\/]/); number = part[2] }
        /^ *}/ && number { if (!complete) { printf "%s%s", comma, number; comma = "," }; number = "" }'
}

# Submits the shards that are not complete, and the merge after them.
submit() {
    tries=$1
    shift
    list=$(missing "$@")
    after=
    if [ -n "$list" ]; then
        array=$(sbatch --parsable --job-name=terrane-shard --output="$out.slurm-%A-%a.log" --array="$list" \
            "$script" shard "$script" "$shards" "$out" "$tries" "$@")
        # The merge also starts if shards fail, and looks for them.
        after=--dependency=afterany:$array
    fi
    sbatch --parsable $after --job-name=terrane-merge --output="$out.slurm-%j.log" \
        "$script" merge "$script" "$shards" "$out" "$tries" "$@"
}

case ${1:-} in
shard)
    shards=$3 out=$4
    shift 5
    exec "$program" "$out" "$@" --shard "$SLURM_ARRAY_TASK_ID/$shards"
    ;;
merge)
    script=$2 shards=$3 out=$4 tries=$5
    shift 5
    list=$(missing "$@")
    if [ -n "$list" ] && [ "$tries" -gt 1 ]; then
        submit $((tries - 1)) "$@"
    else
        # Names the shards that are missing, if there are any.
        exec "$program" "$out" "$@" --merge
    fi
    ;;
[1-9]*)
    script=$(realpath "$0") shards=$1 out=$(realpath -m "$2")
    shift 2
    submit "${TRIES:-3}" "$@"
    ;;
*)
    echo "usage: $0 SHARDS OUT [options of terrane-gen]" >&2
    exit 2
    ;;
esac
