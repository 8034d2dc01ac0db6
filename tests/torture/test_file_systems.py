"""File systems that refuse a system call: one line names the file and what to do, or the work goes on without it."""

import os
import shutil
import subprocess
import sys
from errno import EINVAL, EIO, ENOLCK, ENOSPC, ENOSYS, EOPNOTSUPP, EPERM, EXDEV
from pathlib import Path

import pytest

from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

WORK = """
import os, sys
from pathlib import Path
from one_item import FILES, KEY, commit
from pipeline.commands.terminal import exit_with
from pipeline.store.owned_folder import FolderKind
from pipeline.store.store import Store, StudyRecord

def work():
    root = Path(sys.argv[1])
    store = Store.open(root / "store", create=True)
    with store.lock_study("one"):
        manifest = commit(store)
        for settings in ({}, {"grid": {}}):
            store.write_study(StudyRecord("one", settings, ()))
    assert store.read(manifest, "log") == FILES["log"] and store.verify() == []
    store.read_study("one")
    (root / "out").mkdir()
    for content in (b"first", b"second"):
        with FolderKind("a kind", "puddle.kind", 1, "kind.json").replace(root / "out", {}) as folder:
            folder.write("content", content)
    store.discard("evolve", KEY)
    with store.lock_all():
        print("done")

try:
    work()
except Exception as error:
    exit_with(error)
"""
"""All that puddle does to a disk, as a command."""

READ = """
import sys
from pathlib import Path
from pipeline.store.store import Store

print(Store.open(Path(sys.argv[1]) / "store", create=False).driver_of("one"))
"""


@pytest.fixture(scope="session")
def refusing(tmp_path_factory) -> Path:
    """The library to preload."""
    if sys.platform != "linux" or (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler for a library to preload")
    library = tmp_path_factory.mktemp("refusing") / "refusing.so"
    source = Path(__file__).with_name("refusing_file_system.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library


def work(library: Path, top: Path, call: str, number: int, script: str = WORK) -> subprocess.CompletedProcess[str]:
    refused = {"REFUSED_CALL": call, "REFUSED_ERRNO": str(number), "REFUSED_PATH": str(top)}
    path = os.pathsep.join((str(ROOT), str(ROOT / "tests" / "shared")))
    return subprocess.run(
        [sys.executable, "-c", script, top],
        env={**os.environ, **refused, "LD_PRELOAD": str(library), "PYTHONPATH": path},
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize("number", [ENOSYS, ENOLCK, EOPNOTSUPP])
def test_a_file_system_without_locks_is_named_and_so_is_the_way_out(number, refusing, tmp_path):
    """Lustre without -o flock, NFS without lockd, FUSE."""
    done = work(refusing, tmp_path, "flock", number)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert str(tmp_path / "store") in done.stderr and os.strerror(number) in done.stderr and "--store" in done.stderr


def test_without_locks_a_store_is_read(refusing, tmp_path):
    with Store.open(tmp_path / "store", create=True).lock_study("one"):
        pass
    done = work(refusing, tmp_path, "flock", ENOSYS, READ)
    assert done.stdout == "None\n", done.stderr


@pytest.mark.parametrize(
    ("call", "number"), [("fsync_folder", EINVAL), ("fsync_folder", EOPNOTSUPP), ("rename_into", EXDEV)]
)
def test_a_file_system_of_its_own_kind_is_used(call, number, refusing, tmp_path):
    """VirtualBox's shared folders and old CIFS flush no folders; nothing can be renamed into a container's volume."""
    done = work(refusing, tmp_path, call, number)
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


@pytest.mark.parametrize(
    ("call", "number"),
    [
        ("fsync_folder", EIO),
        ("fsync", EIO),
        ("write", ENOSPC),
        ("read", EIO),
        ("rename", EPERM),
        ("mkdir", EPERM),
        ("unlink", EPERM),
        ("rmdir", EOPNOTSUPP),
    ],
)
def test_every_other_refusal_names_the_file(call, number, refusing, tmp_path):
    done = work(refusing, tmp_path, call, number)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert str(tmp_path) in done.stderr and os.strerror(number) in done.stderr
