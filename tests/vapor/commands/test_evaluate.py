"""`vapor-track evaluate`."""

from tests.helpers.command_line import refuse
from tests.helpers.pages import ReadPage
from vapor.track import main


def test_a_file_of_the_results_in_place_of_their_directory_is_told(tmp_path, capsys):
    (tmp_path / "report.json").write_text("{}")
    line = refuse(["evaluate", str(tmp_path / "report.json")], capsys, "report.json: is a file, expected a directory")
    assert "did you mean" not in line
    (tmp_path / "trajectory.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    refuse(["evaluate", str(tmp_path / "report.json")], capsys, f"wrote, did you mean {tmp_path}?\n")


def test_a_page_beside_the_figures_has_them_too(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "trajectory.tum").write_text("".join(f"{t}.0 0 0 0.04 0 0 0 1\n" for t in range(1, 11)))
    (tmp_path / "run" / "ground_truth.tum").write_text("".join(f"{t}.0 0 0 0 0 0 0 1\n" for t in range(1, 11)))
    assert main(["evaluate", "run", "--output", "figures.json"]) == 0
    page = ReadPage.of((tmp_path / "figures.html").read_text())
    assert "Right from the first image on, 4.0 cm and 0.0° off in the median." in page.words
    assert "vapor-track evaluate run --output figures.json" in page.words
    assert page.cells[page.cells.index("particle filter") + 1].split() == ["0.040", "m", "0.0°"]
    assert main(["evaluate", "run", "--output", "figures.json"]) == 0, "its own page is replaced"
    (tmp_path / "mine.html").write_text("<p>mine</p>")
    refuse(["evaluate", "run", "--output", "mine.json"], capsys, "mine.html")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["figures.html", "figures.json", "mine.html", "run"]
    assert (tmp_path / "mine.html").read_text() == "<p>mine</p>"
