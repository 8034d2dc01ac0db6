"""Published results: what recording an export takes."""

import hashlib
import json

from benchmarks.published import PICTURES, record_pictures


def test_recording_an_export_takes_the_pictures_that_pages_show(tmp_path):
    docs, figures = tmp_path / "docs", tmp_path / "figures"
    (docs / "results").mkdir(parents=True)
    figures.mkdir()
    (figures / "bars.png").write_bytes(b"new")
    stale = {"results": "laptop", "figure": "bars", "of": "analyse", "drawn_from": "old", "sha256": "older"}
    others = {**stale, "results": "row"}
    of_new = hashlib.sha256(b"new").hexdigest()
    document = {"pictures": {"laptop_bars.png": stale, "row_bars.png": others}}
    (docs / PICTURES).write_text(json.dumps(document))
    record_pictures({"study": "laptop", "digests": {"analyse": "d1"}}, figures, docs)
    found = json.loads((docs / PICTURES).read_text())["pictures"]
    assert (docs / "laptop_bars.png").read_bytes() == b"new"
    assert found == {"laptop_bars.png": {**stale, "drawn_from": "d1", "sha256": of_new}, "row_bars.png": others}
