from pathlib import Path

import pytest
import synthetic

from analysis import evidence, rows
from analysis.evidence import Evidence


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


@pytest.fixture
def made(tmp_path: Path) -> synthetic.Made:
    """An empty store to write into."""
    return synthetic.Made(tmp_path / "runs")
