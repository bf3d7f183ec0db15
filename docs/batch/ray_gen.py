"""Makes one tile set on a Ray cluster, whose machines share the folder of OUT and the sources:

    python ray_gen.py SHARDS OUT [options of terrane-gen]

Each shard that is not complete is a task; Ray starts tasks of lost machines again. TERRANE_GEN is the program.
"""

import json
import os
import subprocess
import sys

import ray

PROGRAM = os.environ.get("TERRANE_GEN", "terrane-gen")


def terrane_gen(*arguments: str) -> str:
    done = subprocess.run([PROGRAM, *arguments], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(done.stderr.strip())
    return done.stdout


# A process that is killed leaves what it has completed, and the next one continues it.
@ray.remote(max_retries=3, retry_exceptions=True)
def make_shard(shard: str, out: str, options: list[str]) -> str:
    return terrane_gen(out, *options, "--shard", shard)


def main(count: str, out: str, *options: str) -> None:
    out = os.path.abspath(out)
    plan = json.loads(terrane_gen(out, *options, "--plan", count))
    waiting = [make_shard.remote(s["shard"], out, list(options)) for s in plan["shards"] if not s["complete"]]
    while waiting:
        done, waiting = ray.wait(waiting)
        print(ray.get(done[0]), end="")
    print(terrane_gen(out, *options, "--merge"), end="")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(f"usage: {sys.argv[0]} SHARDS OUT [options of terrane-gen]")
    ray.init(ignore_reinit_error=True)
    main(*sys.argv[1:])
