#!/bin/sh
# A Dask cluster for --scheduler: `sh cluster.sh HOST ...` runs a scheduler here and workers on each host, by ssh
# (here without it, for localhost). All need sdp-vs-penalty[cluster] and see the runs under the same paths.
# Whoever reaches the port can run code as you: keep it inside your network. Ctrl-C ends everything.
set -eu
here=$(hostname -f)
[ "$*" = localhost ] && here=127.0.0.1
address="tcp://$here:${PORT:-8786}"
trap 'trap - EXIT INT TERM; kill 0' EXIT INT TERM
dask scheduler --host "$here" --port "${PORT:-8786}" --no-dashboard &
for host in "$@"; do
  work="OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 dask worker $address --nthreads 1 --nworkers ${WORKERS:-auto} --no-dashboard"
  if [ "$host" = localhost ]; then sh -c "$work" & else ssh "$host" "$work" & fi
done
echo "sdp-vs-penalty identify ROBOT --data 'runs/*.parquet' --out model.json --scheduler $address"
wait
