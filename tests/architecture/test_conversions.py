"""The lines of docs/your-own-tank.md that convert the files of other programs, run on small files of theirs."""

import re
from pathlib import Path

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

from pipeline.store.track_file import read_track_table

PAGE = (Path(__file__).parents[2] / "docs" / "your-own-tank.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.M | re.S)

TIME = np.arange(4) / 60  # [s]
X, Y = 0.1 + TIME, -0.05 - TIME  # [m]
ANGLE = 0.3 + 40 * TIME  # [rad]
OFFSET = 0.03 * np.stack([-np.sin(ANGLE), np.cos(ANGLE)])  # from the centre to the upper point [m]


def lines(rows: list[list[object]]) -> str:
    return "".join(",".join(map(str, row)) + "\n" for row in rows)


def converted(program: str, text: str, folder: Path, monkeypatch: pytest.MonkeyPatch):
    """Run the block that reads ``program``'s file; return the tracks that puddle reads of what it writes."""
    monkeypatch.chdir(folder)
    Path(f"{program}.csv").write_text(text, encoding="utf-8")
    (block,) = (block for block in BLOCKS if f'"{program}.csv"' in block)
    exec(block, {"numpy": np, "pandas": pandas})
    return read_track_table(Path("converted.csv").read_bytes(), "converted.csv")[0]


@pytest.mark.parametrize("animals", [[], ["b1", "b2"]])
def test_deeplabcut(animals, tmp_path, monkeypatch):
    names = [(animal, point, axis) for animal in animals or [""] for point in ("low", "up") for axis in "xyl"]
    heads = {"scorer": ["net"] * len(names), "individuals": [name[0] for name in names]}
    heads |= {"bodyparts": [name[1] for name in names]}
    heads |= {"coords": [name[2].replace("l", "likelihood") for name in names]}
    rows = [[name, *cells] for name, cells in heads.items() if animals or name != "individuals"]
    for frame in range(len(TIME)):
        row = [frame]
        for number, _ in enumerate(animals or [""]):
            for sign in (-1, 1):  # the lower and the upper point, in pixels of 0.5 mm, 540 of them above the waterline
                x, y = X[frame] + 0.2 * number + sign * OFFSET[0, frame], Y[frame] + sign * OFFSET[1, frame]
                row += [x / 0.0005, 540 - y / 0.0005, 0.99 if frame else 0.1]
        rows.append(row)
    tracks = converted("deeplabcut", lines(rows), tmp_path, monkeypatch)
    n_bars = len(animals) or 1
    assert tracks.throw.tolist() == np.repeat(np.arange(n_bars), len(TIME) - 1).tolist()  # frame 0 is not seen
    for number in range(n_bars):
        own = tracks.throw == number
        np.testing.assert_allclose(tracks.time[own], TIME[1:])
        np.testing.assert_allclose(tracks.x[own], X[1:] + 0.2 * number)
        np.testing.assert_allclose(tracks.y[own], Y[1:])
        np.testing.assert_allclose(tracks.angle[own], ANGLE[1:])


@pytest.mark.parametrize("version", ["1.23", "1.24", "1.25"])
def test_motive(version, tmp_path, monkeypatch):
    parts = [("Rotation", axis) for axis in "XYZW"] + [("Position", axis) for axis in "XYZ"]
    bodies = ["Bar 1", "Bar 2", "Bar 1:Marker 1"]
    columns = [(body, *part) for body in bodies for part in parts if "Marker" not in body or part[0] == "Position"]
    code = [""] if version == "1.24" else []  # a column of time codes, an option
    rows: list[list[object]] = [["Format Version", version, "Length Units", "Meters"], []]
    rows.append(["", "Type", *code, *("Rigid Body" + " Marker" * ("Marker" in name) for name, _, _ in columns)])
    rows += [["", label, *code, *(name for name, _, _ in columns)] for label in ("Name", "ID")]
    rows += [["", "Parent", *code, *("" for _ in columns)]] if version == "1.25" else []
    rows.append(["", "", *code, *(part for _, part, _ in columns)])
    rows.append(["Frame", "Time (Seconds)", *(["TimeCode"] if code else []), *(axis for _, _, axis in columns)])
    turns = Rotation.from_euler("ZXY", np.stack([ANGLE, np.full(4, 0.2), np.full(4, -0.1)], axis=1))  # tilted as well
    for frame in range(len(TIME)):
        pose = [*turns[frame].as_quat(), X[frame], Y[frame], 0.4]
        other = [""] * 7 if frame == 2 else pose  # the second bar is lost in a frame
        rows.append([frame, TIME[frame], *(["15:26:46:12.02"] if code else []), *pose, *other, 9, 9, 9])
    tracks = converted("motive", lines(rows), tmp_path, monkeypatch)
    assert tracks.throw.tolist() == [0] * 4 + [1] * 3
    long_axis = turns.apply([0, 1, 0])
    seen = np.array([0, 1, 2, 3, 0, 1, 3])
    np.testing.assert_allclose(tracks.angle, np.arctan2(-long_axis[:, 0], long_axis[:, 1])[seen])
    np.testing.assert_allclose([tracks.time, tracks.x, tracks.y], np.stack([TIME, X, Y])[:, seen])


LOW_UP = np.stack([X - OFFSET[0], Y - OFFSET[1], X + OFFSET[0], Y + OFFSET[1]], axis=1)  # (n_frames, 4)


@pytest.mark.parametrize(
    ("program", "head", "row", "points"),
    [
        (
            "SLEAP",
            "track,frame_idx,instance.score,low.x,low.y,low.score,up.x,up.y,up.score\n",
            "a,{frame},1,{0},{1},1,{2},{3},1\n",
            ("low.x", "low.y", "up.x", "up.y"),
        ),
        (
            "Tracker",
            "\tmass A\t\tmass B\t\t\nt\tx\ty\tx\ty\t\n",
            "{time}\t{0}\t{1}\t{2}\t{3}\n",
            ("x", "y", "x.1", "y.1"),
        ),
        (
            "Vicon",
            "Trajectories\n60\n,,bar:low,,,bar:up,,\nFrame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n",
            "{frame},0,{0},9,{1},{2},9,{3}\n",
            ("X", "Z", "X.1", "Z.1"),
        ),
    ],
)
def test_two_points_of_a_bar(program, head, row, points, tmp_path):
    (f := tmp_path / "t").write_text(
        head + "".join(row.format(*point, frame=n, time=n / 60) for n, point in enumerate(LOW_UP))
    )
    reading, time = re.search(rf"^\| {program}.*?\| `(.*?)` \| time `(.*?)`", PAGE, flags=re.M).groups()
    known = {"pandas": pandas, "numpy": np, "f": f}
    t = eval(reading, known)
    np.testing.assert_allclose(eval(time.replace("100", "60"), known | {"t": t}), TIME)
    x_low, y_low, x_up, y_up = (t[name] for name in points)
    (angle,) = re.findall(r"the angle `(.*?)`", PAGE)
    sides = {"x_low": x_low, "y_low": y_low, "x_up": x_up, "y_up": y_up}
    np.testing.assert_allclose(eval(angle, known | sides), ANGLE)
