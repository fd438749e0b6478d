"""Which file system a folder is on: network file systems cannot share memory, or lose locks.

SQLite's write-ahead log needs memory that all processes of a file share. On a network file system, two hosts have two
such memories. The log then works at first, and the file is damaged later (SQLite, "Write-Ahead Logging", section 1).
"""

import re
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

MOUNTS = Path("/proc/mounts")
"""The table of mounts of Linux; where there is none, no file system is recognised."""
NETWORK = {
    "NFS": "nfs nfs4",
    "SMB": "cifs smb2 smb3 smbfs ncpfs",
    "Lustre": "lustre",
    "GPFS": "gpfs",
    "BeeGFS": "beegfs fhgfs",
    "Ceph": "ceph",
    "AFS": "afs auristorfs",
    "9P": "9p",
    "virtiofs": "virtiofs",
    "a cluster file system": "gfs2 ocfs2 panfs orangefs pvfs2 wekafs glusterfs coda dvs cvfs",
    "a folder of the host": "drvfs vboxsf vmhgfs prl_fs",
    "FUSE": "fuse fuseblk",
}
"""The types of network file systems in `MOUNTS`, by the name that users know; any `fuse.NAME` is FUSE, too.

FUSE may be sshfs, GlusterFS, JuiceFS, a drive in the cloud or another: the table does not say whether the files are on
another host. A virtual machine does not share its memory with its host (WSL, VirtualBox, VMware, Parallels)."""
NAMES = {kind: name for name, kinds in NETWORK.items() for kind in kinds.split()}
ESCAPE = re.compile(r"\\([0-7]{3})")


def network_file_system(path: Path) -> str:
    """Return the name of the network file system of a file or folder; "" if it is local.

    The path need not exist. Symbolic links are followed. The mount with the longest path that contains the file
    decides; of several mounts on one path, the last hides the others.
    """
    resolved, depth, kind = path.resolve(), -1, ""
    for mount, mounted_kind in _mounts():
        if resolved.is_relative_to(mount) and len(mount.parts) >= depth:
            depth, kind = len(mount.parts), mounted_kind
    return NAMES.get(kind.partition(".")[0], "")


def _mounts() -> Iterator[tuple[Path, str]]:
    """Yield the path and the type of each mount; blanks and some other characters of a path are octal escapes."""
    try:
        table = MOUNTS.read_text(encoding="utf-8", errors="surrogateescape")
    except OSError:  # not on Linux, or hidden
        return
    for line in table.splitlines():
        if len(fields := line.split(" ")) >= 3:
            yield Path(ESCAPE.sub(lambda match: chr(int(match[1], 8)), fields[1])), fields[2]


def has_locks(folder: Path) -> bool:
    """Return whether files of a folder can be locked by `fcntl`; Lustre without the option `flock` has no locks.

    A folder in which no file can be made counts as one with locks: SQLite will say what is wrong.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return True
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            return _succeeds(partial(fcntl.lockf, probe, fcntl.LOCK_EX | fcntl.LOCK_NB))
    except OSError:
        return True


def _succeeds(lock: Callable[[], object]) -> bool:
    try:
        lock()
    except OSError:
        return False
    return True
