"""A Slurm on this machine, of the packages slurmctld, slurmd, slurm-client and munge: started and ended by a test."""

import os
import shutil
import socket
import subprocess
import time
from contextlib import ExitStack, contextmanager, suppress

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch")
WHY_NOT = (
    "it runs as root only"
    if os.geteuid()
    else ", ".join(f"{name} is missing" for name in PROGRAMS if shutil.which(name) is None)
)
"""Why there can be no Slurm on this machine: apt-get install slurmctld slurmd slurm-client munge; "" if there can."""
CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket
CryptoType=crypto/munge
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SwitchType=switch/none
MpiDefault=none
ReturnToService=2
JobRequeue=1
KillWait=5
SchedulerParameters=sched_interval=1,sched_min_interval=0,batch_sched_delay=0
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
NodeName={host} NodeAddr=127.0.0.1 CPUs=2 SocketsPerBoard=1 CoresPerSocket=2 ThreadsPerCore=1 RealMemory=2000
PartitionName=all Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""
PATIENCE = 120.0
"""How long the daemons may take to be ready, s."""


def free_ports(count):
    """Return ports that nobody listens to."""
    with ExitStack() as opened:
        sockets = [opened.enter_context(socket.socket()) for _ in range(count)]
        for each in sockets:
            each.bind(("127.0.0.1", 0))
        return [each.getsockname()[1] for each in sockets]


@contextmanager
def slurm(folder):
    """Run a Slurm with one node in a folder; yield the variables of the environment by which its commands find it."""
    host = socket.gethostname().partition(".")[0]
    for name in ("state", "spool", "munge"):
        (folder / name).mkdir(mode=0o700)
    (folder / "munge" / "key").write_bytes(os.urandom(128))
    (folder / "munge" / "key").chmod(0o400)
    configuration = folder / "slurm.conf"
    configuration.write_text(CONFIGURATION.format(host=host, folder=folder, ports=free_ports(2)))
    munge = [f"--{name}={folder}/munge/{file}" for name, file in MUNGE_FILES.items()]
    daemons, found = [], {"SLURM_CONF": str(configuration)}
    with (folder / "daemons.log").open("w") as log:

        def begin(*words):
            daemons.append(subprocess.Popen(words, stdout=log, stderr=log, start_new_session=True))

        try:
            begin("munged", "--foreground", "--force", *munge)
            wait_for(lambda: (folder / "munge" / "socket").exists(), folder)
            begin("slurmctld", "-D", "-f", configuration)
            begin("slurmd", "-D", "-f", configuration, "-N", host)
            wait_for(lambda: "idle" in output(found, "sinfo", "--noheader", "--format=%t"), folder)
            yield found
        finally:
            if len(daemons) == 3:  # a job that is still ending would wait for its daemon for ever
                output(found, "scancel", "--user=root")
                with suppress(AssertionError):
                    wait_for(lambda: not output(found, "squeue", "--noheader"), folder, 30.0)
            for daemon in reversed(daemons):
                daemon.terminate()
                try:
                    daemon.wait(20)
                except subprocess.TimeoutExpired:
                    daemon.kill()
                    daemon.wait()


MUNGE_FILES = {"socket": "socket", "key-file": "key", "log-file": "log", "pid-file": "pid", "seed-file": "seed"}


def output(found, *words):
    """Return the output of a command of Slurm; "" if it fails."""
    return subprocess.run(words, env=os.environ | found, capture_output=True, text=True, check=False).stdout


def wait_for(condition, folder, within=PATIENCE):
    """Wait until something is true, s; show the logs of the daemons if it never is."""
    end = time.monotonic() + within
    while not condition():
        if time.monotonic() > end:
            logs = "\n".join(f"{file.name}:\n{file.read_text()[-2000:]}" for file in sorted(folder.glob("*.log")))
            raise AssertionError(f"it never came\n{logs}")
        time.sleep(0.2)
