import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pandas as pd
import pytest

from analysis import report
from analysis.data import evidence, rows
from analysis.data.evidence import Evidence
from tests.analysis.synthetic import Made, episodes, trials


class Page(HTMLParser):
    """Counts tags that are opened and never closed, and collects links."""

    VOID = ("meta", "img", "link", "br", "hr", "input")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for key, value in attrs if key in ("href", "src")]
        if tag not in (*self.VOID, "p", "li"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("p", "li"):
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def composed(root: Path, profile: str | None = None) -> report.Report:
    return report.compose(evidence.gather(rows.load(root), profile))


def test_the_page_stands_alone(folder: Path) -> None:
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert page.open == []
    outside = [link for link in page.links if not link.startswith(("data:", "#"))]
    assert outside == ["https://arxiv.org/abs/2410.18495"]
    assert len([link for link in page.links if link.startswith("data:image/png")]) == 7
    ids = re.findall(r'id="([^"]+)"', (folder / "report.html").read_text(encoding="utf-8"))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(ids)
    assert len(ids) == len(set(ids))


def test_files_of_the_report(folder: Path) -> None:
    assert {path.stem for path in folder.glob("tables/*.tex")} == {
        "main", "paired", "ablation_encoder", "ablation_curriculum", "deployment", "claims",
    }  # fmt: skip
    assert not (folder / "tables" / "real.csv").exists()  # nothing of ours in it
    for path in folder.glob("tables/*.csv"):
        assert path.read_text(encoding="utf-8").startswith("# profile laptop")
    assert {path.suffix for path in folder.glob("figures/*")} == {".pdf", ".png", ".csv"}
    assert json.loads((folder / "run.json").read_text())["kind"] == "report"
    linked = re.findall(r"\]\(([^)]+)\)", (folder / "report.md").read_text(encoding="utf-8"))
    assert linked and all((folder / name).is_file() for name in linked)


def test_provenance_names_every_run_with_its_call_and_where_its_settings_are(folder: Path, full: Evidence) -> None:
    html, plain = ((folder / f"report.{ending}").read_text(encoding="utf-8") for ending in ("html", "md"))
    for text in (Page(html).text, plain):
        for run in full.store.runs:
            assert f"{run.kind}/{run.name}/{run.id}/config.yaml" in text
        assert text.count("$ formctl eval") == sum(run.kind == "eval" for run in full.store.runs)
        assert "AMD EPYC, 2 cores, 23.5 GiB" in text and "torch 2.13.0" in text and "38e1a72" in text
        assert text.count("eval.strict_radius: 0.21") == 1  # what all evaluations share


def test_what_a_run_has_of_its_own_stands_with_it(made: Made, tmp_path: Path) -> None:
    folders = [made.evaluation(made.baseline("hover"), episodes(20, 0.5)) for _ in range(3)]
    settings = {"scenario": {"hit_radius": 0.2}, "eval": {"strict_radius": 0.21}}
    (folders[1] / "config.yaml").write_text(json.dumps(settings))
    (folders[2] / "config.yaml").unlink()
    text = Page((report.write(composed(made.root), tmp_path / "out") / "report.html").read_text(encoding="utf-8")).text
    own = [text.rpartition(f"{folder.name}/")[2].partition("eval/hover")[0] for folder in folders]
    assert ["scenario.hit_radius: 0.2" in part for part in own] == [False, True, False]
    assert own[0].startswith("config.yaml") and own[2].startswith("run.json")


def test_one_more_evaluation_adds_a_few_lines(made: Made, tmp_path: Path) -> None:
    size = []
    for number in range(5):
        folder = made.evaluation(made.baseline("hover"), episodes(20, 0.5, bank=f"{number}" * 12))
        many = {f"key{k}": {f"inner{n}": n for n in range(20)} for k in range(15)} | {"seed": number}
        tree = json.loads((folder / "config.yaml").read_text()) | many
        (folder / "config.yaml").write_text(json.dumps(tree))
        out = report.write(composed(made.root), tmp_path / "out")
        size.append(sum(path.stat().st_size for path in out.glob("report.*")))
    assert size[4] - size[3] < 2_000 < len(json.dumps(many))


def test_every_artefact_says_its_profile(folder: Path) -> None:
    for path in (*folder.glob("tables/*"), *folder.glob("figures/*.csv"), folder / "report.md", folder / "report.html"):
        assert "laptop" in path.read_text(encoding="utf-8"), path


def test_the_same_store_gives_the_same_page(made: Made, tmp_path: Path) -> None:
    study = made.run("search", "stage1")
    trials(6).to_parquet(study / "trials.parquet")
    made.evaluation(
        made.policy(made.training(log=False)), [episodes(30, 0.8), episodes(20, 0.7, balls=0, scenario="static")]
    )
    for name in ("one", "two"):
        report.write(composed(made.root), tmp_path / name)
    files = [path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file()]
    assert {"report.html", "report.md", "main.tex", "main.csv", "simplex.pdf", "sweep_columns.png"} <= {
        p.name for p in files
    }
    for path in files:
        assert (tmp_path / "one" / path).read_bytes() == (tmp_path / "two" / path).read_bytes(), path


def test_an_empty_store_gives_the_skeleton(tmp_path: Path) -> None:
    page = composed(tmp_path / "runs")
    folder = report.write(page, tmp_path / "out")
    text = Page((folder / "report.html").read_text(encoding="utf-8")).text
    assert "No episode has been flown under profile laptop yet" in text
    assert not any(section.measured for section in page.sections)
    assert text.count("formctl ") == 1 and "formctl reproduce survey=paper profile=laptop" in text and "--plan" in text
    assert list((folder / "figures").iterdir()) == []
    assert "data:image" not in (folder / "report.html").read_text(encoding="utf-8")


def test_another_profile_is_named_but_not_shown(made: Made) -> None:
    for profile, count in (("laptop", 20), ("smoke", 17)):
        policy = made.training(profile=profile, log=False)
        made.evaluation(made.policy(policy), episodes(count, 1.0), profile=profile)
    pages = {name: composed(made.root, name) for name in ("smoke", "laptop")}
    text = {name: "\n".join(table.frame().to_csv() for table in page.tables()) for name, page in pages.items()}
    assert "17/17" in text["smoke"] and "17/17" not in text["laptop"]
    assert "20/20" in text["laptop"] and pages["laptop"].others == {
        "smoke": f"formctl report --profile smoke --runs {made.root}"
    }


def test_what_was_left_out_is_listed(made: Made, tmp_path: Path) -> None:
    folder = made.evaluation(made.baseline("hover"), episodes(5, 0.0))
    (folder / "episodes.parquet").write_bytes(b"not parquet")
    text = (report.write(composed(made.root), tmp_path / "out") / "report.html").read_text(encoding="utf-8")
    assert "Left out" in text and "is not a readable Parquet file" in text


def test_a_report_is_whole_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = composed(tmp_path / "runs")

    def break_off(*_: object) -> str:
        raise OSError("No space left on device")

    monkeypatch.setattr("analysis.report.files._page", break_off)
    with pytest.raises(OSError, match="No space left"):
        report.write(page, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_earlier_report_is_replaced_and_nothing_else_is(tmp_path: Path) -> None:
    page = composed(tmp_path / "runs")
    out = report.write(page, tmp_path / "out")
    (out / "stale").write_text("")
    assert not (report.write(page, out) / "stale").exists()
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "thesis.tex").write_text("years")
    with pytest.raises(ValueError, match="is not empty and holds no report"):
        report.write(page, precious)
    assert (precious / "thesis.tex").exists()


def test_the_summary_repeats_the_main_table(page: report.Report) -> None:
    (line,) = page.summary
    row = page.main.rows[0]
    assert row[1].text in line and row[1].details[-1] in line and row[3].text in line and "0.278" in line


def test_tables_csv_has_full_precision(folder: Path, page: report.Report) -> None:
    read = pd.read_csv(folder / "tables" / "main.csv", comment="#")
    assert read["cfr"].tolist() == pytest.approx([row[1].value for row in page.main.rows], abs=1e-15)
