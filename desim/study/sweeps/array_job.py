"""A sweep as an array job of Slurm: the scripts of its parts and of the merge, and their states.

Each part has a store of its own in a folder that the machines share. Before its time is up, a part ends its sweep,
which keeps all runs that have ended, and asks Slurm to run it again.
"""

import json
import shlex
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Self

from pydantic import TypeAdapter, ValidationError

from desim.config.interrupts import deferred
from desim.config.whole_files import write_whole

RECORD = "submit.json"
"""The file in the folder of a sweep that says how it was cut into parts, and as which jobs it was submitted."""
PART_SCRIPT, MERGE_SCRIPT = "parts.sbatch", "merge.sbatch"
LOGS, CLAIMS = "logs", "claims"
"""The folders of the outputs of the parts, and of the lots that they claim."""
WARNED = 60
"""The time before the end of a part at which Slurm warns it, s; Slurm looks at the time once a minute."""
RESTARTS = 20
"""The largest number of times that a part is run again; a part too short for one run would be repeated for ever."""
SLURM_TIMEOUT = 30.0
"""The time limit of a command of Slurm, s."""


class SlurmError(OSError):
    """Raised when a command of Slurm is missing or fails; the message has the output of the command."""


@dataclass(frozen=True, kw_only=True)
class ArrayJob:
    """A sweep that is cut into the parts of an array job."""

    name: str
    """The name of the scenario."""
    runs: int
    """The number of runs of the whole sweep."""
    parts: int
    """The number of tasks of the array."""
    claim: bool = False
    """Whether parts claim small lots; otherwise each has its fixed share."""
    jobs: tuple[str, ...] = ()
    """The numbers of the array jobs that were submitted, the newest last."""

    def write(self, folder: Path) -> None:
        """Write the record to a folder.

        Raises:
            OSError: if the record cannot be written.
        """
        write_whole(folder / RECORD, f"{json.dumps(asdict(self), indent=2)}\n".encode())

    @classmethod
    def read(cls, folder: Path) -> Self | None:
        """Return the record in a folder; None if there is none.

        Raises:
            ValueError: if the file is not such a record.
        """
        path = folder / RECORD
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        try:
            with deferred():  # see `Value.model_rebuild`
                adapter = TypeAdapter(cls)
            fields = adapter.validate_json(content, strict=True)
        except ValidationError as error:
            place = ".".join(map(str, error.errors(include_url=False)[0]["loc"])) or "it"
            raise ValueError(f"{path}: is damaged: {place} cannot be read; remove the file and submit again") from None
        return fields

    def planned(self, part: int) -> int | None:
        """Return the number of runs of a part, counted from 1; None if parts claim lots."""
        return None if self.claim else len(range(part - 1, self.runs, self.parts))

    def store(self, folder: Path, part: int) -> Path:
        """Return the path of the store of a part."""
        name = "sweep.sqlite" if self.claim else f"sweep.{part}-of-{self.parts}.sqlite"
        return folder / f"part-{part}" / name


@dataclass(frozen=True, kw_only=True)
class Resources:
    """The resources that each part of an array job requests."""

    time: str = "02:00:00"
    """The time limit, as Slurm writes it."""
    cpus: int = 1
    """The number of cores, and of worker processes."""
    memory: str = "1G"
    """The memory for each core."""
    options: tuple[str, ...] = ()
    """Further options of sbatch."""


def part_script(
    job: ArrayJob, folder: Path, program: Sequence[str], made_by: str, parts: Sequence[int], resources: Resources
) -> str:
    """Return the script of an array job that performs some parts of a sweep, given their numbers.

    All machines see the folder under this path. `program` is the words of the command that performs the sweep,
    without its part and its folder; `made_by` is the command that made the script.
    """
    options = (
        f"--array={_ranges(parts)}",
        f"--cpus-per-task={resources.cpus}",
        f"--mem-per-cpu={resources.memory}",
        f"--time={resources.time}",
        "--requeue",
        "--open-mode=append",
        f"--signal=B:USR1@{WARNED}",
        f"--output={_logs(folder)}/%A-%a.log",
        *resources.options,
    )
    share = shlex.join(["--claim", str(folder / CLAIMS)]) if job.claim else f'--shard "$part/{job.parts}"'
    return f"""{_head(job.name, made_by, options)}
part=$SLURM_ARRAY_TASK_ID
{shlex.join(program)} {share} -j "$SLURM_CPUS_PER_TASK" -o {shlex.quote(str(folder))}/"part-$part" &
sweep=$!

# The sweep keeps the runs that have ended. Slurm runs this part again, and the sweep goes on.
again() {{
    kill -TERM "$sweep"
    wait "$sweep"
    if [ "${{SLURM_RESTART_COUNT:-0}}" -ge {RESTARTS} ]; then
        echo "the time was up {RESTARTS + 1} times: give each part more of it (--time)" >&2
        exit 1
    fi
    exec scontrol requeue "${{SLURM_ARRAY_JOB_ID}}_$part"
}}
trap again USR1
trap 'kill -TERM "$sweep"; wait "$sweep"; exit $?' TERM
wait "$sweep"
"""


def merge_script(job: ArrayJob, folder: Path, program: Sequence[str], made_by: str, resources: Resources) -> str:
    """Return the script of the job that merges the parts; see `part_script`."""
    options = ("--time=00:30:00", f"--mem={resources.memory}", f"--output={_logs(folder)}/merge-%j.log")
    where = shlex.quote(str(folder))
    head = _head(f"{job.name}-merge", made_by, (*options, *resources.options))
    return f"{head}\n{shlex.join(program)} {where}/part-* -o {where}\n"


def _head(name: str, made_by: str, options: Sequence[str]) -> str:
    """Return the first lines of a script: its options, and its working folder."""
    lines = [f"#SBATCH {shlex.quote(option)}" for option in (f"--job-name={name}", *options)]
    change_folder = f"cd {shlex.quote(str(Path.cwd()))}"
    return "\n".join(["#!/bin/bash", *lines, f"# Made by: {made_by}", "set -uo pipefail", change_folder])


def _logs(folder: Path) -> str:
    """Return the folder of the outputs as a pattern of Slurm, in which % stands for a number unless it is doubled."""
    return str(folder / LOGS).replace("%", "%%")


def _ranges(numbers: Sequence[int]) -> str:
    """Return ascending numbers as Slurm writes them: 1-3,7."""
    texts, begin = [], numbers[0]
    for number, following in zip(numbers, [*numbers[1:], None], strict=True):
        if following != number + 1:
            texts.append(str(number) if begin == number else f"{begin}-{number}")
            begin = following if following is not None else begin
    return ",".join(texts)


def submit_scripts(folder: Path) -> str:
    """Submit the scripts in a folder, the merge as a job that begins after the parts; return the number of the array.

    Raises:
        SlurmError: if there is no Slurm, or it refuses a script.
    """
    number = slurm("sbatch", "--parsable", str(folder / PART_SCRIPT)).partition(";")[0].strip()
    slurm("sbatch", "--parsable", f"--dependency=afterany:{number}", str(folder / MERGE_SCRIPT))
    return number


def record_of(job: ArrayJob, number: str) -> ArrayJob:
    """Return the record of a job that was submitted once more."""
    return replace(job, jobs=(*job.jobs, number))


def states(jobs: Sequence[str]) -> Mapping[int, str]:
    """Return the state of each part that waits or runs, such as RUNNING; none if there is no Slurm."""
    by_part: dict[int, str] = {}
    for number in jobs:
        try:
            lines = slurm("squeue", "--noheader", "--array", "--format=%K %T", f"--jobs={number}").splitlines()
        except SlurmError:  # squeue also refuses a job that ended long ago
            continue
        for line in lines:
            part, _, state = line.strip().partition(" ")
            if part.isdecimal():
                by_part[int(part)] = state
    return by_part


def slurm(*words: str) -> str:
    """Return the output of a command of Slurm.

    Raises:
        SlurmError: if it is missing or fails.
    """
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=SLURM_TIMEOUT, check=False)
    except FileNotFoundError:
        raise SlurmError(f"{words[0]}: there is no Slurm on this machine") from None
    except subprocess.TimeoutExpired:
        raise SlurmError(f"{words[0]}: Slurm does not answer within {SLURM_TIMEOUT:g} s") from None
    if done.returncode:
        raise SlurmError(f"{words[0]}: {done.stderr.strip() or f'exit code {done.returncode}'}")
    return done.stdout
