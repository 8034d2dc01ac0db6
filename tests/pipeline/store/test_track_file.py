"""Tracks files: what is read of CSV and Parquet, and what is refused."""

import numpy as np
import pandas
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import PuddleError
from pipeline.store.track_file import bars_of, has_bars, read_track_columns, track_table

CSV = b"\xef\xbb\xbfthrow, time ,x,y,angle,note\n3,0,0.1,-0.2,0.5,a\n\n3,0.5,0.2,-0.3,0.6,b\n"


def test_csv_and_parquet_give_the_same_columns() -> None:
    from_csv = read_track_columns(CSV, "a.csv")
    assert list(from_csv) == ["throw", "time", "x", "y", "angle"]
    table = pa.table({name: pa.array(of) for name, of in from_csv.items()} | {"note": ["a", "b"]})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink)
    from_parquet = read_track_columns(bytes(sink.getvalue()), "a.parquet")
    for name, of in from_csv.items():
        np.testing.assert_array_equal(from_parquet[name], of)
    read = track_table(from_csv, "a.csv")
    assert read.throw.tolist() == [3, 3] and read.angle.tolist() == [0.5, 0.6] and read.x_sd is None


def test_deviations_and_bars_may_be_columns() -> None:
    line = b"throw,time,x,y,angle,x_sd,y_sd,angle_sd,length,width,mass\n"
    columns = read_track_columns(line + b"1,0,0,0,0,1,2,3,0.07,0.07,0.1\n1,1,0,0,0,1,2,3,0.07,0.07,0.1\n", "a.csv")
    assert track_table(columns, "a.csv").angle_sd.tolist() == [3, 3]
    assert has_bars(columns) and bars_of(columns, "a.csv").length.tolist() == [0.07]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "a.csv: expected a row for each frame, got none"),
        (b"throw,time,x,y,angle\n", "a.csv: expected a row for each frame, got none"),
        (b"a,b\n1,0\n", "a.csv: expected columns named throw, time, x, .* got a, b"),
        (b"throw,time,x,y,angle\n1_0,0,0,0,0\n", "a.csv: .*column #0: Row #2: .*'1_0'"),
        (b"throw,time,x,y\n1,0,0,0\n", "a.csv: expected the columns .*, got none named angle: name the columns so"),
        (b"throw,time,x,x,y,angle\n1,0,0,0,0,0\n", "a.csv: the column x appears twice"),
        (b"throw,time,x,y,angle\n1,0,0,zero,0\n", "a.csv: .*column #3: Row #2: .*'zero'"),
        (b"throw,time,x,y,angle\n1,0,0,0\n", "a.csv: .*Row #2: Expected 5 columns, got 4"),
        (b"throw,time,x,y,angle\n1.5,0,0,0,0\n", "a.csv: row 1: throw is 1.5, expected a whole number"),
        (
            b"throw,time,x,y,angle,x_sd\n1,0,0,0,0,1\n",
            "a.csv: has x_sd but no y_sd, angle_sd: expected all three or none",
        ),
        (b"t,x,y\n0,1,2\n", "a.csv: recognised a file of Tracker with one point, which has no angle"),
        (b"PAR1 and no more", "a.csv: cannot be read as Parquet"),
    ],
)
def test_what_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(PuddleError, match=message):
        track_table(read_track_columns(content, "a.csv"), "a.csv")


def test_bars_that_change_within_a_throw_are_refused() -> None:
    rows = b"throw,length,width,mass\n1,0.07,0.07,0.1\n1,0.14,0.035,0.1\n"
    with pytest.raises(PuddleError, match=r"throw 1: length is 0\.14 and 0\.07: expected one bar for each throw"):
        bars_of(read_track_columns(rows, "bars.csv"), "bars.csv")


ROWS = [(0, 0.0, 0.1, -0.2, 0.5), (0, 0.5, 0.2, -0.3, 0.6), (1, 0.0, 1.5, -0.25, 0.0)]
PLAIN = "throw,time,x,y,angle\n" + "".join(",".join(map(str, row)) + "\n" for row in ROWS)


def with_points(head: str, row: str) -> tuple[str, list[list[float]]]:
    """Frames 0 and 60 of a bar that is upright at (1, 2), and then lies with its upper end to the left."""
    first, second = ((1, 1.5), (1, 2.5)), ((1.5, 2), (0.5, 2))
    text = head + "".join(row.format(f=f, t=f / 60, a=a, b=b) + "\n" for f, (a, b) in ((0, first), (60, second)))
    return text, TURNED


MOTIVE = """Format Version,1.23,Take Notes,,Capture Frame Rate,60.000000,Rotation Type,{0},Length Units,Meters

,Type,{1}
,Name,{2}
,ID,{2}
,,{3}
Frame,Time (Seconds),{4}
"""
"""The seven lines before the data, by what was exported."""
QUATERNION = MOTIVE.format(
    "Quaternion",
    "Rigid Body" + 6 * ",Rigid Body",
    "Bar" + 6 * ",Bar",
    4 * "Rotation," + 3 * "Position,",
    "X,Y,Z,W,X,Y,Z,",
)
EULER = MOTIVE.format(
    "XYZ", "Rigid Body" + 5 * ",Rigid Body", "Bar" + 5 * ",Bar", 3 * "Rotation," + 3 * "Position,", "X,Y,Z,X,Y,Z,"
)
MARKERS = MOTIVE.format(
    "Quaternion", "Marker" + 5 * ",Marker", "a,a,a,b,b,b", "Position" + 5 * ",Position", "X,Y,Z,X,Y,Z"
)
TURNED = [[0, 0, 1, 2, 0], [0, 1, 1, 2, np.pi / 2]]
FOREIGN = [
    ("text in utf-16", PLAIN.encode("utf-16"), ROWS),
    ("text in cp1252", PLAIN.replace("angle", "angle,°").replace("\n0", ",\n0").encode("cp1252"), None),
    ("columns named Throw", PLAIN.replace("throw,time,x", "Throw,Time [s],X"), ROWS),
    ("semicolons between cells, decimal commas", PLAIN.replace(",", ";").replace(".", ","), ROWS),
    ("tabs between cells", PLAIN.replace(",", "\t"), ROWS),
    ("a row of units", PLAIN.replace("\n", "\n,s,m,m,rad\n", 1), ROWS),
    ("lines of comments", "# filmed by me\n" + PLAIN.replace("\n", "\n# more\n", 1), ROWS),
    (
        "lines of comments, tabs between cells, columns named",
        "% a\n" + PLAIN.replace(",", "\t").replace("angle", "Angle (rad)"),
        ROWS,
    ),
    (
        "a file of Motive in meters",
        QUATERNION + "0,0,0,0,0,1,1,2,9,0.1\n9,0.1,,,,,,,,\n60,1,0,0,0.7071067811865476,0.7071067811865476,1,2,9,0.1\n",
        TURNED,
    ),
    ("a file of Motive in meters", EULER + "0,0,0,0,0,1,2,9,0.1\n60,1,0,0,90,1,2,9,0.1\n", TURNED),
    ("a file of Motive in meters", *with_points(MARKERS, "{f},{t},{a[0]},{a[1]},9,{b[0]},{b[1]},9")),
    (
        "a file of DeepLabCut",
        *with_points(
            "scorer,n,n,n,n,n,n\nbodyparts,a,a,a,b,b,b\ncoords,x,y,likelihood,x,y,likelihood\n",
            "{f},{a[0]},{a[1]},1,{b[0]},{b[1]},1",
        ),
    ),
    (
        "a file of DeepLabCut",
        *with_points(
            "scorer,n,n,n,n,n,n\nindividuals,i,i,i,i,j,j\nbodyparts,a,a,b,b,a,a\ncoords,x,y,x,y,x,y\n9,,,,,1,2\n",
            "{f},{a[0]},{a[1]},{b[0]},{b[1]},,",
        ),
    ),
    (
        "a file of SLEAP",
        *with_points(
            "track,frame_idx,instance.score,a.x,a.y,a.score,b.x,b.y,b.score\n,1,nan,1,2,,,,\n",
            ",{f},1,{a[0]},{a[1]},1,{b[0]},{b[1]},1",
        ),
    ),
    (
        "a file of Tracker",
        *with_points("\tmass A\t\tmass B\t\t\nt\tx\ty\tx\ty\t\n0.1\t\t\t1\t2\n", "{t}\t{a[0]}\t{a[1]}\t{b[0]}\t{b[1]}"),
    ),
    (
        "a file of Tracker",
        *with_points("#multi:\n,A,,B,,\nt,frame,x,y,frame,x,y,\n", "{t},{f},{a[0]},{a[1]},{f},{b[0]},{b[1]},"),
    ),
]


@pytest.mark.parametrize(("what", "content", "rows"), FOREIGN)
def test_a_file_of_another_notation_is_recognised_and_its_lines_convert_it(
    tmp_path, monkeypatch, what, content, rows
) -> None:
    monkeypatch.chdir(tmp_path)
    content = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "mine.csv").write_bytes(content)
    with pytest.raises(PuddleError, match=f"^mine.csv: recognised {what}") as refused:
        read_track_columns(content, "mine.csv")
    assert "codec" not in str(refused.value)
    exec("\n".join(line.strip() for line in str(refused.value).splitlines()[1:]), {"pandas": pandas, "numpy": np})
    columns = read_track_columns((tmp_path / "converted.csv").read_bytes(), "converted.csv")
    if rows is not None:
        found = np.stack([columns[name] for name in ("throw", "time", "x", "y", "angle")], axis=1)
        np.testing.assert_allclose(found, rows, atol=1e-9)


@pytest.mark.parametrize("kind", ["timedelta64[us]", "datetime64[ns]"])
def test_durations_and_time_stamps_of_parquet_are_converted_to_seconds(tmp_path, monkeypatch, kind) -> None:
    monkeypatch.chdir(tmp_path)
    table = pandas.DataFrame(ROWS[:2], columns=["throw", "time", "x", "y", "angle"])
    table["time"] = (table["time"] * 1e9).astype("int64").astype("timedelta64[ns]")
    if kind.startswith("datetime"):
        table["time"] += pandas.Timestamp("2026-01-01")
    table.to_parquet("mine.parquet")
    with pytest.raises(PuddleError, match=r"mine.parquet: recognised time is a (duration|timestamp)") as refused:
        read_track_columns((tmp_path / "mine.parquet").read_bytes(), "mine.parquet")
    exec("\n".join(line.strip() for line in str(refused.value).splitlines()[1:]), {"pandas": pandas})
    columns = read_track_columns((tmp_path / "converted.csv").read_bytes(), "converted.csv")
    assert columns["time"].tolist() == [0.0, 0.5]
