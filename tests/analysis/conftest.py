from pathlib import Path

import pytest

from analysis import report
from analysis.data import evidence, rows
from analysis.data.evidence import Evidence
from tests.analysis import synthetic


@pytest.fixture(scope="session")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store in which everything was measured; read only."""
    folder = tmp_path_factory.mktemp("store") / "runs"
    synthetic.full_store(folder, count=60)
    return folder


@pytest.fixture(scope="session")
def full(root: Path) -> Evidence:
    """Its evidence."""
    return evidence.gather(rows.load(root))


@pytest.fixture(scope="session")
def page(full: Evidence) -> report.Report:
    """Its report."""
    return report.compose(full)


@pytest.fixture(scope="session")
def folder(page: report.Report, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report's files; read only."""
    return report.write(page, tmp_path_factory.mktemp("report") / "report", {"kind": "report"})


@pytest.fixture
def made(tmp_path: Path) -> synthetic.Made:
    """An empty store to write into."""
    return synthetic.Made(tmp_path / "runs")
