"""`puddle verify`, `puddle gc` and `puddle doctor` as a person uses them, on a store with a study that is done."""

import contextlib
import errno
import json
import os
import re
import shlex
import shutil
import socket
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from pipeline import doctor, gc
from pipeline.artifacts import encode_sealed, key_of
from pipeline.cli import main
from pipeline.cluster import Done, TaskFailed, Ticket, session
from pipeline.configuration import parse
from pipeline.errors import DamagedArtifact, PuddleError
from pipeline.settings import RESIDUAL_ENVIRONMENTS, Settings
from pipeline.stages import STAGES
from pipeline.store import Store
from pipeline.study import survey

SETTINGS = """name: tiny
grid: {depths: [1.0], environments: [dry_land], single_member_depths: [], n_trials: 1}
rollout: {n_settle: 5, n_measure: 20}
evolution: {n_generations: 4, afpo: {population_size: 4}}
transfer: {n_generations: 2}
assess: {n_designs: 8}
work: {generations_per_item: 2, engine: reference}
"""


def call(*arguments: str) -> int:
    with pytest.raises(SystemExit) as exit_info:
        main(list(arguments))
    return int(exit_info.value.code or 0)


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """A folder with a settings file, and a store with its study."""
    folder = tmp_path_factory.mktemp("done")
    (folder / "tiny.yaml").write_text(SETTINGS)
    options = ["--settings", str(folder / "tiny.yaml"), "--store", str(folder / "store")]
    assert call("study", "--workers", "0", *options) == 0
    return folder


@pytest.fixture
def options(done, tmp_path) -> list[str]:
    """Options for a copy of it."""
    shutil.copytree(done, tmp_path, dirs_exist_ok=True)
    return ["--settings", str(tmp_path / "tiny.yaml"), "--store", str(tmp_path / "store")]


@pytest.fixture
def store(options) -> Store:
    return Store.open(Path(options[-1]), create=False)


def n_items(store: Store) -> int:
    return sum(1 for stage in store.stages() for _ in store.keys(stage))


# -- verify ----------------------------------------------------------------------------------------------------------


def test_a_store_that_is_well_verifies(options, store, capsys):
    assert call("verify", *options) == 0
    assert f"{n_items(store)} items" in capsys.readouterr().out


def test_damage_is_named_discarded_and_mended(options, store, capsys):
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert str(path) in said and "study tiny: evolve dry_land/1m/trial-0#" in said and "verify --settings" in said
    assert path.exists()
    assert call("verify", "--discard", *options) == 1
    assert not path.exists() and "`puddle study --settings" in capsys.readouterr().out
    assert call("study", "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *options) == 0


def swap_for_a_manifest(record: Path) -> None:
    shutil.copy(next(record.parents[2].rglob("manifest.json")), record)


def make_newer(document: Path) -> None:
    """As a newer puddle would have sealed it."""
    found = json.loads(document.read_text())
    body = {name: inner for name, inner in found.items() if name not in ("schema", "version", "sha256")}
    document.write_bytes(encode_sealed(body, schema=found["schema"], version=found["version"] + 1))


@pytest.mark.parametrize(("spoil", "mends"), [(swap_for_a_manifest, True), (make_newer, False)])
def test_damage_is_named_where_the_record_can_not_be_read_either(spoil, mends, options, store, capsys):
    """A foreign file where the record was is damage; a newer puddle's record is none, and is left as it is."""
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    path.write_bytes(b"")
    record = store.root / "studies" / "tiny" / "study.json"
    spoil(record)
    assert call("verify", "--discard", *options) == 1
    said = capsys.readouterr().out
    assert str(record) in said and f"of no study: evolve {path.parent.name}" in said
    assert not path.exists()
    assert call("study", "--workers", "0", *options) == (0 if mends else 2)
    assert call("verify", *options) == (0 if mends else 1)


def test_a_report_that_was_edited_is_noticed(options, store, capsys):
    (store.export_path("tiny") / "index.html").write_text("better")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert "index.html: expected SHA-256" in said and "puts it back" in said and "computed again" not in said
    assert call("study", "--workers", "0", *options) == 0
    assert call("verify", *options) == 0


def test_the_report_of_a_study_that_is_driven_is_left_out(options, store, capsys):
    """Its driver keeps the record before it puts the report where people look."""
    (store.export_path("tiny") / "index.html").write_text("an earlier one")
    with store.lock_study("tiny"), store.lock_study("new"):
        assert call("verify", *options) == 0
    said = capsys.readouterr().out
    assert "study tiny is driven by process" in said and "the copy of its report was left out" in said
    assert "every byte is as it was committed" in said
    assert call("verify", *options) == 1


def make_a_manifest_newer(store: Store) -> None:
    make_newer(next(store.root.glob("items/analyse/*/*/manifest.json")))


def make_another_record_newer(store: Store) -> None:
    store.write_study("newer", {}, ())
    make_newer(store.study_path("newer") / "study.json")


def put_a_file_for_a_folder(store: Store) -> None:
    """No item is found below it, and asking for one that the record lists fails."""
    prefix = next(store.root.glob("items/analyse/*"))
    shutil.rmtree(prefix)
    prefix.touch()


@pytest.mark.parametrize(
    ("spoil", "expected"),
    [
        (make_a_manifest_newer, "A newer puddle wrote it"),
        (make_another_record_newer, "A newer puddle wrote it"),
        (put_a_file_for_a_folder, "Not a directory"),
    ],
)
def test_what_discarding_does_not_mend_hides_nothing_else(spoil, expected, options, store, capsys):
    spoil(store)
    (lost,) = list(store.root.glob("items/evolve/*/*/manifest.json"))[:1]
    lost.unlink()
    (store.export_path("tiny") / "index.html").write_text("better")
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert expected in said
    assert f"{lost}: expected the manifest of study tiny's evolve dry_land/1m/trial-0#" in said
    assert "index.html: expected SHA-256" in said


def test_files_that_lost_their_manifest_are_told_of_as_unfinished(options, store, capsys):
    """Of a study that was stopped, whose record lists no items; so are those of a driver that is at work."""
    store.write_study("tiny", store.read_study("tiny").settings, ())
    assert call("verify", *options) == 0
    assert "unfinished" not in capsys.readouterr().out
    lost = next(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    assert call("verify", *options) == 0
    said = capsys.readouterr().out
    assert said.startswith("1 unfinished items: files without a manifest") and "every byte" in said
    (advised,) = re.findall(r"`puddle (.*?)`", said)
    assert call(*shlex.split(advised)) == 0 and not lost.parent.exists()
    capsys.readouterr()
    assert call("verify", *options) == 0
    assert "unfinished" not in capsys.readouterr().out


def test_what_a_study_lists_and_lacks_is_damage_and_not_unfinished(options, store, capsys):
    lost = next(store.root.glob("items/evolve/*/*/manifest.json"))
    lost.unlink()
    assert call("verify", *options) == 1
    said = capsys.readouterr().out
    assert f"{lost}: expected the manifest" in said and "unfinished" not in said


def test_what_a_message_of_damage_advises_mends_it(options, store, capsys):
    """Whoever reads the item, and from whatever folder."""
    (path,) = list(store.root.glob("items/evolve/*/*/history.parquet"))[:1]
    good = path.read_bytes()
    path.write_bytes(good[:-1] + b"?")
    with pytest.raises(DamagedArtifact) as told:
        store.read(store.manifest("evolve", path.parent.name), path.name)
    assert str(path) in str(told.value) and "nothing else is lost" in str(told.value)
    discard, study = re.findall(r"`puddle (.*?)`", str(told.value))
    assert call(*shlex.split(discard)) == 1 and not path.exists()
    assert call(study, "--workers", "0", *options) == 0
    assert path.read_bytes() == good
    assert call("verify", *options) == 0


# -- gc --------------------------------------------------------------------------------------------------------------


def test_nothing_that_a_study_needs_is_garbage(options, store, capsys):
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert "that no study needs" not in capsys.readouterr().out
    assert call("verify", *options) == 0


def test_what_no_study_needs_is_listed_then_removed(options, store, capsys):
    before = n_items(store)
    assert call("study", "--workers", "0", *options, "--set", "seed=2") == 0
    said = capsys.readouterr().err
    assert "study tiny had other settings until now (seed: 1 → 2). Its report will be replaced" in said
    both = n_items(store)
    assert both > before
    half = store.root / "items" / "evolve" / "00" / ("0" * 64)
    half.mkdir(parents=True)
    (half / ".history.parquet.tmp").write_bytes(b"half")
    assert call("gc", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert "items that no study needs" in said and "whose commit never ended" in said and "gc --store" in said
    assert n_items(store) == both and half.exists()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert "MB are free again" in capsys.readouterr().out
    assert n_items(store) == before and not half.exists()
    assert call("verify", *options) == 0
    assert call("gc", "--store", str(store.root)) == 0
    assert "that no study needs" not in capsys.readouterr().out


def test_what_gc_advises_is_for_the_store_that_it_looked_at(options, store, monkeypatch, capsys):
    monkeypatch.chdir(store.root.parent)
    monkeypatch.setenv("PUDDLE_STORE", "elsewhere")
    (store.root / "items" / "evolve" / "00" / ("0" * 64)).mkdir(parents=True)
    assert call("gc", "--store", "store") == 0
    assert "`puddle gc --store store --remove` removes it" in capsys.readouterr().out


def test_a_persons_files_are_no_garbage_whatever_their_names(options, store, capsys):
    folder = store.export_path("tiny")
    ours, theirs = folder / ".index.html.tmp", folder / ".notes.tmp"
    ours.write_text("half")
    theirs.write_text("mine")
    (folder / ".drafts.tmp").mkdir()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert str(ours) in said and not ours.exists()
    assert theirs.read_text() == "mine" and (folder / ".drafts.tmp").is_dir() and "notes" not in said


def test_a_study_that_was_stopped_half_way_keeps_what_it_has(options, store):
    record = store.read_study("tiny")
    chosen = {**record.settings, "evolution": {**record.settings["evolution"], "n_generations": 8}}
    store.write_study("tiny", chosen, ())  # as a driver does before the first piece: it lists none
    evolved = [item.key for item in record.items if item.stage == "evolve"]
    found = {key for _, key in gc.find_garbage(store).items}
    assert evolved and not found & set(evolved)  # its first four generations are those of the longer study
    assert found >= {item.key for item in record.items if item.stage == "report"}


@pytest.fixture
def evolving(study, settings, tmp_path, monkeypatch) -> Store:
    """A copy of a store with a study in every world, whose record lists nothing yet: as while it evolves."""
    monkeypatch.setattr(session, "PLACE", tmp_path)
    found = Store.open(shutil.copytree(study[0].root, tmp_path / "evolving"), create=False)
    found.write_study(settings.name, settings.model_dump(mode="json"), ())
    return found


LOST = [
    ("collect", "throws-2", 0),
    ("train", "member-01", 0),
    *(("evolve", f"{world}/1m/trial-1", index) for world in ("dry_land", "residual_slush") for index in (0, 1)),
    ("transfer", "dry_land/1m/trial-0", 0),
    ("assess", "true_slush/1m/trial-0", 0),
]


@pytest.mark.parametrize("lost", [[one] for one in LOST] + [LOST])
def test_what_stands_behind_a_gap_is_no_garbage(lost, study, settings, evolving):
    """What was discarded is computed again, to the same bytes: what depends on it will be found where it is."""
    assert not gc.find_garbage(evolving).items
    _, upstream = study
    gone = [upstream[stage].done[label][index] for stage, label, index in lost]
    files = [{name: evolving.read(one, name) for name in one.files} for one in gone]
    for one in gone:
        evolving.discard(one.stage, one.key)
    garbage = gc.find_garbage(evolving)
    assert not garbage.items and len(garbage.halves) == len(gone)
    gc.remove(evolving, garbage)
    assert not gc.find_garbage(evolving).items
    for one, data in zip(gone, files, strict=True):
        evolving.commit(one.stage, one.key, one.identity, data, record=one.record)
    found = survey(settings, STAGES, evolving, say=str)
    assert not any(of.unfinished or of.set_aside for of in found.values())


def test_what_follows_from_other_networks_is_garbage_though_those_are_not_made_yet(study, settings, evolving):
    """And a gc that dies leaves what the next one removes: who depends on something goes before it."""
    other = settings.model_dump(mode="json")
    other["training"]["n_iterations"] += 1
    evolving.write_study(settings.name, other, ())
    garbage = gc.find_garbage(evolving)
    _, upstream = study
    old = [*upstream["train"].done.values(), *upstream["assess"].done.values()]
    old += [
        chain
        for stage in ("evolve", "transfer")
        for label, chain in upstream[stage].done.items()
        if label.startswith(RESIDUAL_ENVIRONMENTS)
    ]
    assert set(garbage.items) >= {(one.stage, one.key) for chain in old for one in chain}
    for n_removed, (stage, key) in enumerate(garbage.items, 1):
        evolving.remove(stage, key)
        assert set(gc.find_garbage(evolving).items) == set(garbage.items[n_removed:])


@pytest.mark.parametrize(
    "identity",
    [{}, {"inputs": [7]}, {"inputs": {"before": []}}, {"inputs": {"before": "gone"}, "version": 2, "spec": 7}],
)
def test_an_item_that_a_stranger_sealed_is_garbage(identity, study, evolving):
    key = key_of(identity)
    evolving.commit("evolve", key, identity, {"population.safetensors": b"?"}, record={})
    evolving.discard("evolve", study[1]["evolve"].done["dry_land/1m/trial-0"][0].key)  # a chain with a gap
    assert ("evolve", key) in gc.find_garbage(evolving).items


def test_nothing_is_removed_while_a_study_is_driven_or_can_not_be_read(options, store, capsys):
    with store.lock_study("other"):
        assert call("gc", "--remove", "--store", str(store.root)) == 2
    assert "study other is driven by process" in capsys.readouterr().err
    with store.lock_all(), pytest.raises(PuddleError, match="`puddle gc` is removing"), store.lock_study("tiny"):
        pass
    (store.root / "studies" / "tiny" / "study.json").write_text("{}")
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    assert "study.json" in capsys.readouterr().err
    assert n_items(store) == sum(1 for _ in store.root.glob("items/*/*/*/manifest.json"))


def test_nothing_is_looked_at_while_garbage_is_removed(options, store, capsys):
    """An item on its way out would be called damaged."""
    with store.lock_all():
        for command in ("status", "--digests"), ("status",), ("verify",):
            assert call(*command, *options) == 2
            assert "`puddle gc` is removing what no study needs. Wait for its end." in capsys.readouterr().err
        (found,) = doctor._store(store.root, parse(Settings, SETTINGS, name="tiny"))
        assert found.verdict == "fail" and "`puddle gc` is removing" in found.found
    with store.lock_to_read():
        assert call("status", *options) == call("verify", *options) == 0


def test_a_study_of_another_puddle_is_told(options, store, tmp_path, capsys):
    store.write_study("tiny", {**store.read_study("tiny").settings, "wings": 2}, ())
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert "expected settings of this puddle" in said and "wings: Extra inputs" in said and "nothing is removed" in said
    kit = str(tmp_path / "kit")
    assert call("fabricate", "--study", "tiny", "--out", kit, "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert said.startswith("puddle: study tiny: expected settings of this puddle") and "wings" in said


def test_what_a_study_needs_that_lost_its_record_stays_until_it_is_forgotten(options, store, capsys):
    before = n_items(store)
    (store.study_path("tiny") / "study.json").unlink()
    assert call("gc", "--remove", "--store", str(store.root)) == 2
    said = capsys.readouterr().err
    assert "study.json: expected a study's record, came no file" in said and "Run it again, or delete" in said
    assert n_items(store) == before
    shutil.rmtree(store.study_path("tiny"))
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert n_items(store) == 0


def test_a_study_that_begins_while_garbage_is_collected_is_not_in_the_way(options, store):
    with store.lock_all():
        with pytest.raises(PuddleError, match="`puddle gc` is removing"), store.lock_study("new"):
            pass
        assert not gc.find_garbage(store).items
    assert not store.study_path("new").exists()


def test_folders_of_dead_drivers_are_swept(options, store, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(session, "PLACE", tmp_path)
    dead = tmp_path / "puddle-12345678"
    dead.mkdir()
    (dead / "lock").touch()
    stranger = tmp_path / "puddle-stranger"
    stranger.mkdir()
    assert call("gc", "--store", str(store.root)) == 0
    said = capsys.readouterr().out
    assert f"{dead}: left by a driver that is dead" in said and str(stranger) not in said and dead.exists()
    assert call("gc", "--remove", "--store", str(store.root)) == 0
    assert not dead.exists() and stranger.exists()


# -- doctor ----------------------------------------------------------------------------------------------------------


def verdicts(store: Path, **how) -> dict[str, doctor.Finding]:
    settings = parse(Settings, SETTINGS, name="tiny")
    return {finding.what: finding for finding in doctor.examine(settings, store, n_workers=how.get("n_workers", 0))}


def test_the_doctor_examines_a_machine_on_which_the_tests_run(options, capsys):
    assert call("doctor", "--workers", "0", *options) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(line.startswith(("ok ", "warn ", "      ")) for line in lines)
    for what in ("python", "versions", "processor", "memory", "disk", "store", "temporary", "loopback", "engine"):
        assert any(what in line for line in lines), what


def test_the_doctor_finds_what_is_wrong(store, tmp_path, monkeypatch):
    monkeypatch.setattr(doctor, "SPARE_BYTES", 1e18)
    monkeypatch.setattr(doctor, "BYTES_PER_WORKER", 1e15)
    monkeypatch.setenv("RAY_ADDRESS", "head:6379")
    constraints = tmp_path / "constraints.txt"
    constraints.write_text("numpy==0.1\nBox2D==2.3.10\n")
    monkeypatch.setattr(doctor, "CONSTRAINTS", constraints)
    monkeypatch.setattr(doctor, "_ray", lambda: doctor.Finding("ok", "ray", "not asked"))
    with store.lock_study("tiny"):
        found = verdicts(store.root, n_workers=1)
    assert found["disk"].verdict == "fail" and "puddle gc" in found["disk"].advice
    assert found["memory"].verdict == "fail" and "--workers 0" in found["memory"].advice
    assert found["versions"].verdict == "warn" and "numpy" in found["versions"].found
    assert found["ports"].verdict == "warn" and "RAY_ADDRESS=head:6379" in found["ports"].found
    assert "study tiny is driven by process" in found["store"].found


def test_the_doctor_refuses_a_disk_whose_locks_do_not_lock(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.disk, "try_lock", lambda path: 0)
    assert verdicts(tmp_path)["store"].verdict == "fail"


def test_the_doctor_finds_a_store_that_may_not_be_written_to(store, tmp_path, monkeypatch):
    """Permissions alone would not keep root out."""

    def refuse(*, prefix: str, dir: Path) -> None:  # noqa: A002
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(dir / prefix))

    monkeypatch.setattr(doctor, "tempfile", SimpleNamespace(TemporaryDirectory=refuse))
    settings = parse(Settings, SETTINGS, name="tiny")
    for place, existing in ((store.root, store.root), (tmp_path / "new" / "store", tmp_path)):
        _, found = doctor._store(place, settings)
        assert (found.verdict, found.what) == ("fail", "store")
        assert found.found.startswith(f"{existing}: a file can't be kept there for good: ")
        assert "Permission denied" in found.found and "permission to write: --store" in found.advice


@contextlib.contextmanager
def as_nobody() -> Iterator[None]:
    """Be nobody for a moment: nothing keeps root out."""
    if os.geteuid() != 0:
        yield
        return
    os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(0)


def test_the_doctor_says_where_it_may_not_look(tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    with as_nobody():
        (found,) = doctor._store(closed / "store", parse(Settings, SETTINGS, name="tiny"))
    closed.chmod(0o700)
    assert (found.verdict, found.what) == ("fail", "store")
    assert found.found.startswith(f"{closed / 'store'}: looking for the store's disk failed: Permission denied")
    assert "choose another place" in found.found


def test_the_doctor_asks_for_no_room_for_what_is_kept_already(store, tmp_path, monkeypatch):
    """A disk with half of the room that a study takes in all holds the rest of one that is nearly done."""
    settings = parse(Settings, SETTINGS, name="tiny")
    free = int(doctor.SPARE_BYTES + doctor.bytes_left_of_study(settings, {}) / 2)
    monkeypatch.setattr(doctor, "shutil", SimpleNamespace(disk_usage=lambda path: SimpleNamespace(free=free)))

    def disk_of(root: Path) -> doctor.Finding:
        return next(found for found in doctor._store(root, settings) if found.what == "disk")

    assert disk_of(tmp_path / "new").verdict == "fail"
    assert disk_of(store.root).verdict == "ok"
    for key in store.keys("report"):  # the page: most of so small a study
        store.discard("report", key)
    assert disk_of(store.root).verdict == "fail"


@pytest.mark.parametrize(("done", "verdict"), [
    ((Ticket(0, "getpid"), Done(7)), "ok"),
    ((Ticket(0, "getpid"), TaskFailed("getpid", "WorkerCrashedError: it died", "", True)), "fail"),
    (None, "fail"),
])  # fmt: skip
def test_the_doctor_says_that_ray_is_well_where_it_worked(monkeypatch, done, verdict):
    @contextlib.contextmanager
    def cluster(*_, **__):
        yield SimpleNamespace(submit=lambda function: None, next_done=lambda timeout: done)

    monkeypatch.setattr(doctor, "ray_cluster", cluster)
    found = doctor._ray()
    assert (found.verdict, found.what) == (verdict, "ray")
    assert ("it died" in found.found) == (done is not None and isinstance(done[1], TaskFailed))


def test_the_doctor_judges_memory_by_what_is_free_in_the_container(monkeypatch):
    monkeypatch.setattr(doctor, "free_memory", lambda: 2 * 10**9)
    found = doctor._memory(8)
    assert found.verdict == "fail" and "2.0 GB free" in found.found and "--workers 2" in found.advice
    assert doctor._memory(2).verdict == "ok"


def test_the_doctor_finds_that_a_port_is_taken(monkeypatch):
    for name in ("RAY_ADDRESS", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(name, raising=False)
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with contextlib.suppress(OSError):  # somebody has it already: so much the better
            taken.bind(("127.0.0.1", 5000))
            taken.listen()
        found = doctor._loopback()
    assert (found.verdict, found.what) == ("warn", "ports")
    assert "5000 is taken" in found.found and "--port" in found.advice
