"""Tracks files: what is read of CSV and Parquet, and what is refused."""

import gzip

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pipeline.errors import PuddleError
from pipeline.store.track_file import read_bars, read_track_table

CSV = b"\xef\xbb\xbfthrow, time ,x,y,angle,note\n3,0,0.1,-0.2,0.5,a\n\n3,0.5,0.2,-0.3,0.6,b\n"


def test_csv_and_parquet_give_the_same_columns() -> None:
    columns = {"throw": [3, 3], "time": [0, 0.5], "x": [0.1, 0.2], "y": [-0.2, -0.3], "angle": [0.5, 0.6]}
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns | {"note": ["a", "b"]}), sink)
    for content, name in ((CSV, "a.csv"), (bytes(sink.getvalue()), "a.parquet")):
        read, bars = read_track_table(content, name)
        assert {column: getattr(read, column).tolist() for column in columns} == columns
        assert read.x_sd is None and bars is None


PLAIN = "throw,time,x,y,angle\n" + "".join(f"1,0.{i},-{i}.25,0.5,0.{i}\n" for i in range(4))
GERMAN = PLAIN.replace(",", ";").replace(".", ",")


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.replace("\n", "\r\n"),
        PLAIN.replace("\n", "\r"),
        PLAIN.replace(",", ";"),
        GERMAN,
        PLAIN.replace(",", "\t"),
        f"sep=,\n{PLAIN}",
        f'"sep=;"\r\n{GERMAN}',
        f",,,,\n\n{PLAIN},,,,\n , ,,,\n\n",
        f'{PLAIN}"","","","",""',
        PLAIN.replace("\n1", "\n,,,,\n1", 2),
        PLAIN.replace("\n", ",,\n"),
        PLAIN.replace(",", "\t").encode("utf-16"),
        gzip.compress(PLAIN.encode(), mtime=0),
        GERMAN.encode("cp1252"),
        PLAIN.replace("\n", ",1\n").replace("angle,1", "angle,Neigung [°]").encode("cp1252"),
    ],
)
def test_tables_of_spreadsheets_are_read(content: str | bytes) -> None:
    read, _ = read_track_table(content if isinstance(content, bytes) else content.encode(), "a.csv")
    assert (read.throw.tolist(), read.time.tolist()) == ([1] * 4, [0, 0.1, 0.2, 0.3])
    assert (read.x.tolist(), read.y.tolist()) == ([-0.25, -1.25, -2.25, -3.25], [0.5] * 4)
    assert read.angle.tolist() == read.time.tolist()


def test_deviations_and_bars_may_be_columns() -> None:
    line = b"throw,time,x,y,angle,x_sd,y_sd,angle_sd,length,width,mass\n"
    content = line + b"1,0,0,0,0,1,2,3,0.07,0.07,0.1\n1,1,0,0,0,1,2,3,0.07,0.07,0.1\n"
    table, bars = read_track_table(content, "a.csv")
    assert table.angle_sd.tolist() == [3, 3]
    assert bars.length.tolist() == read_bars(content, "a.csv").length.tolist() == [0.07]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "a.csv: expected CSV .*Empty CSV file"),
        (b"throw,time,x,y,angle\n", "a.csv: expected a row for each frame, got none"),
        (b"a,b\n1,0\n", "a.csv: expected the columns throw, time, x, .* got a, b, without .*docs/your-own-tank.md"),
        (b"Throw;time;x;y;angle\n1;0;0;0;0\n", "a.csv: expected the columns .* got Throw, time, x, y, angle, without"),
        (b"throw;time;x;y;angle\n1;0;0,5;0.5;0\n", "a.csv: .*Row #2: .*'0.5'"),
        ("throw,time,x,y,Neigung [°]\n".encode("cp1252"), r"got throw, time, x, y, Neigung \[°\], without angle"),
        (b"throw,time,x,y,angle\n1,1_0,0,0,0\n", "a.csv: .*column #1: Row #2: .*'1_0'"),
        (b"throw,time,x,x,y,angle\n1,0,0,0,0,0\n", 'a.csv: .*Field "x" exists 2 times'),
        (b"throw,time,x,y,angle\n1,0,0,0\n", "a.csv: .*Row #2: Expected 5 columns, got 4"),
        (b"throw,time,x,y,angle\n1.5,0,0,0,0\n", "a.csv: row 1: throw is 1.5, expected a whole number"),
        (b"throw,time,x,y,angle\na,0,0,0,0\n,0,0,0,0\n", "a.csv: row 2: throw is empty, expected"),
        (b"throw,time,x,y,angle\n2.02611E+16,0,0,0,0\n", r"throw is 2.02611E\+16, expected .* all its digits"),
        (b"throw,time,x,y,angle,x_sd\n1,0,0,0,0,1\n", "a.csv: expected the columns .*, without y_sd, angle_sd"),
        (b"\x89HDF\r\n\x1a\n" + bytes(20), "a.csv: .*got a binary file: `puddle track` .* videos.*your-own-tank.md"),
        (b'{"throw": [1]}', "a.csv: expected the columns .* without throw"),
        (gzip.compress(b"throw,time,x,y,angle\n", mtime=0)[:-9], "a.csv: .*Truncated"),
        (b"PAR1 and no more", "a.csv: expected CSV or Parquet .*: Parquet magic bytes"),
    ],
)
def test_what_is_refused(content: bytes, message: str) -> None:
    with pytest.raises(PuddleError, match=message):
        read_track_table(content, "a.csv")


STAMP = 20261128103632000  # 17 digits; doubles are 4 apart there


@pytest.mark.parametrize(
    ("labels", "read"),
    [
        (["3.0", " 10", "+4"], [3, 10, 4]),
        ([STAMP, STAMP + 1, STAMP + 2], [STAMP, STAMP + 1, STAMP + 2]),
        (["trial_01", "trial_1", "2026-11-28T10:36:32"], ["trial_01", "trial_1", "2026-11-28T10:36:32"]),
        (["7", "b"], ["7", "b"]),
        ([10**19, 10**19 + 1], [str(10**19), str(10**19 + 1)]),
    ],
)
def test_throws_are_labels_that_are_compared_exactly(labels, read) -> None:
    header, row = b"throw,time,x,y,angle,length,width,mass\n", ",0,0,0,0,0.07,0.07,0.1\n"
    table, bars = read_track_table(header + "".join(f"{label}{row}" for label in labels).encode(), "a.csv")
    assert table.throw.tolist() == read and sorted(bars.throw.tolist()) == sorted(read)


def test_throws_of_parquet_are_exact_or_refused() -> None:
    columns = {name: pa.array([0.0, 0.0]) for name in ("time", "x", "y", "angle")}

    def read(throw: pa.Array):
        sink = pa.BufferOutputStream()
        pq.write_table(pa.table(columns | {"throw": throw}), sink)
        return read_track_table(bytes(sink.getvalue()), "a.parquet")[0].throw.tolist()

    assert read(pa.array([STAMP, STAMP + 1])) == [STAMP, STAMP + 1]
    assert read(pa.array([3.0, 4.0])) == [3, 4]
    assert read(pa.array(["a", "b"]).dictionary_encode()) == ["a", "b"]
    with pytest.raises(PuddleError, match=r"throw is 2\.02\d+e\+16, expected a whole number with all its digits"):
        read(pa.array([float(STAMP), STAMP + 4.0]))


def test_bars_of_a_spreadsheet_are_read() -> None:
    bars = read_bars("throw;length;width;mass;Größe\r\n1;0,07;0,07;0,1;XL\r\n;;;;\r\n".encode("cp1252"), "bars.csv")
    assert (bars.throw.tolist(), bars.length.tolist(), bars.mass.tolist()) == ([1], [0.07], [0.1])


def test_bars_that_change_within_a_throw_are_refused() -> None:
    rows = b"throw,length,width,mass\n1,0.07,0.07,0.1\n1,0.14,0.035,0.1\n"
    with pytest.raises(PuddleError, match=r"throw 1: length is 0\.14 and 0\.07: expected one bar for each throw"):
        read_bars(rows, "bars.csv")
