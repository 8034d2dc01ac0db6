"""File systems that refuse a system call: one line names the file and what to do, or the work goes on without it."""

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from errno import EINVAL, EIO, ENOLCK, ENOSPC, ENOSYS, EOPNOTSUPP, EPERM, EXDEV
from pathlib import Path

import pytest

from pipeline.store.store import Store

ROOT = Path(__file__).parents[2]

SCRIPT = """
import json, os, sys
from pathlib import Path
from one_item import FILES, KEY, commit
from pipeline.commands.terminal import exit_with
from pipeline.store.owned_folder import FolderKind
from pipeline.store.store import Store, StudyRecord

def work(root):
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

def read(root):
    print(Store.open(root / "store", create=False).driver_of("one"))

def run(top, call, number, does):
    files = [os.open(Path(top) / name, os.O_WRONLY | os.O_CREAT) for name in ("stdout", "stderr")]
    os.environ |= {"REFUSED_CALL": call, "REFUSED_ERRNO": str(number), "REFUSED_PATH": f"{top}/disk"}
    for ours, file in enumerate(files, start=1):
        os.dup2(file, ours)
    try:
        globals()[does](Path(top) / "disk")
    except Exception as error:
        exit_with(error)

for case in json.load(sys.stdin):
    if (child := os.fork()) == 0:
        run(*case)
        sys.exit()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""All that puddle does to a disk, as commands: each is a fork of one process, because imports take seconds."""

NO_LOCKS = [("flock", number) for number in (ENOSYS, ENOLCK, EOPNOTSUPP)]
OF_A_KIND = [("fsync_folder", EINVAL), ("fsync_folder", EOPNOTSUPP), ("rename_into", EXDEV)]
REFUSALS = [("fsync_folder", EIO), ("fsync", EIO), ("write", ENOSPC), ("read", EIO), ("rename", EPERM)]
REFUSALS += [("mkdir", EPERM), ("unlink", EPERM), ("rmdir", EOPNOTSUPP)]


@dataclass
class Ended:
    """A command's disk, exit code and output."""

    disk: Path
    code: int
    stdout: str
    stderr: str


@pytest.fixture(scope="module")
def ended(tmp_path_factory) -> dict[tuple[str, int, str], Ended]:
    """Every command, by the call that was refused, its error, and what was done."""
    if sys.platform != "linux" or (compiler := shutil.which("cc")) is None:
        pytest.skip("no C compiler for a library to preload")
    library = tmp_path_factory.mktemp("refusing") / "refusing.so"
    source = Path(__file__).with_name("refusing_file_system.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    keys = [(*of, "work") for of in (*NO_LOCKS, *OF_A_KIND, *REFUSALS)] + [("flock", ENOSYS, "read")]
    tops = [tmp_path_factory.mktemp("refused") for _ in keys]
    for top in tops:
        (top / "disk").mkdir()
    with Store.open(tops[-1] / "disk" / "store", create=True).lock_study("one"):
        pass
    path = os.pathsep.join((str(ROOT), str(ROOT / "tests" / "shared")))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env={**os.environ, "LD_PRELOAD": str(library), "PYTHONPATH": path},
        input=json.dumps([(str(top), *key) for top, key in zip(tops, keys, strict=True)]),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return {
        key: Ended(top / "disk", int(code), (top / "stdout").read_text(), (top / "stderr").read_text())
        for key, top, code in zip(keys, tops, done.stdout.split(), strict=True)
    }


@pytest.mark.parametrize(("call", "number"), NO_LOCKS)
def test_a_file_system_without_locks_is_named_and_so_is_the_way_out(call, number, ended):
    """Lustre without -o flock, NFS without lockd, FUSE."""
    done = ended[call, number, "work"]
    assert done.code == 2 and len(done.stderr.splitlines()) == 1
    assert str(done.disk / "store") in done.stderr and os.strerror(number) in done.stderr and "--store" in done.stderr


def test_without_locks_a_store_is_read(ended):
    done = ended["flock", ENOSYS, "read"]
    assert done.stdout == "None\n", done.stderr


@pytest.mark.parametrize(("call", "number"), OF_A_KIND)
def test_a_file_system_of_its_own_kind_is_used(call, number, ended):
    """VirtualBox's shared folders and old CIFS flush no folders; nothing can be renamed into a container's volume."""
    done = ended[call, number, "work"]
    assert (done.code, done.stdout, done.stderr) == (0, "done\n", "")


@pytest.mark.parametrize(("call", "number"), REFUSALS)
def test_every_other_refusal_names_the_file(call, number, ended):
    done = ended[call, number, "work"]
    assert done.code == 2 and len(done.stderr.splitlines()) == 1
    assert str(done.disk) in done.stderr and os.strerror(number) in done.stderr
