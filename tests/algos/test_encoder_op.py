"""The C++ operator against PyTorch's modules: values and gradients, every number of tokens, masks, and where it stands
aside."""

from pathlib import Path

import pytest
import torch
from torch import Tensor

from algos.encoder import Encoder, build_encoder
from algos.encoder_op import GROUPS
from envs import native
from envs.spec import Observation
from tests.algos.conftest import LAYOUT, encoder_spec, observation

CASES = [(1, 3, 2), (5, 3, 2), (64, 3, 2), (7, 3, 0), (9, 4, 3), (6, 6, 5), (3, 1, 0), (0, 3, 2)]
"""Episodes, drones and balls; rows fill blocks of sixteen or not."""


def pair(choice: str = "attention", **changes: object) -> tuple[Encoder, Encoder]:
    """The encoder by operator, and in PyTorch with twice the digits; weights as after training, not as at the start."""
    fast = build_encoder(encoder_spec(choice, **changes), LAYOUT)
    for parameter in fast.parameters():
        parameter.data += 0.2 * torch.randn_like(parameter)
    plain = build_encoder(encoder_spec(choice, **(changes | {"attention": "sdpa"})), LAYOUT).double()
    plain.load_state_dict(fast.state_dict())
    assert fast.op is not None
    assert plain.op is None
    return fast, plain


def differentiated(encoder: Encoder, given: Observation, dtype: torch.dtype) -> list[Tensor]:
    """Features, then gradients of every group and parameter."""
    obs = {name: x if x.dtype == torch.bool else x.to(dtype, copy=True).requires_grad_() for name, x in given.items()}
    out = encoder(obs)
    weights = torch.randn(out.shape, generator=torch.Generator().manual_seed(1)).to(dtype)
    wanted = [*(obs[name] for name in GROUPS), *encoder.parameters()]
    return [out, *torch.autograd.grad((out * weights).sum(), wanted, materialize_grads=True)]


def assert_alike(fast: list[Tensor], plain: list[Tensor]) -> None:
    for one, other in zip(fast, plain, strict=True):
        size = other.abs().max().item() if other.numel() else 0.0
        torch.testing.assert_close(one.double(), other, rtol=1e-5, atol=1e-5 * max(size, 0.1))


@pytest.mark.parametrize(("episodes", "drones", "balls"), CASES)
@pytest.mark.parametrize("absent", [True, False])
def test_values_and_gradients_are_those_of_the_modules(episodes: int, drones: int, balls: int, absent: bool) -> None:
    fast, plain = pair()
    obs = observation(episodes, drones, balls, absent=absent)
    assert_alike(differentiated(fast, obs, torch.float32), differentiated(plain, obs, torch.float64))


@pytest.mark.parametrize(
    ("choice", "changes"), [("release", {}), ("attention", {"heads": 4}), ("attention", {"width": 64})]
)
def test_other_sizes(choice: str, changes: dict[str, int]) -> None:
    fast, plain = pair(choice, **changes)
    obs = observation(6)
    assert_alike(differentiated(fast, obs, torch.float32), differentiated(plain, obs, torch.float64))


def test_a_team_without_any_obstacle() -> None:
    """A lone drone sees no token but its own; with others, the tokens nobody has are left out."""
    fast, plain = pair()
    for drones in (1, 3):
        obs = observation(6, drones)
        obs["dynamic_mask"][:] = False
        obs["static_mask"][:] = False
        obs["static"][:] = float("nan")
        results = differentiated(fast, obs, torch.float32)
        assert all(x.isfinite().all() for x in results)
        obs["static"] = torch.zeros_like(obs["static"])
        assert_alike(results, differentiated(plain, obs, torch.float64))


def test_large_numbers_and_what_is_not_finite() -> None:
    """Saturated activations agree; a NaN that is seen is passed on to its row and to no other."""
    fast, plain = pair()
    obs = observation(8, absent=False)
    obs["self"][:, :, :, :5] *= 100
    assert_alike(differentiated(fast, obs, torch.float32), differentiated(plain, obs, torch.float64))
    obs["self"][3, 1, 0, 7] = float("nan")
    bad = fast(obs).isnan().any(-1)
    assert bad[3, 1]
    assert bad.sum() == 1


def test_gathered_parameters_serve_many_calls() -> None:
    fast, _ = pair()
    obs = observation()
    gathered = fast.gathered()
    shared = torch.autograd.grad((fast(obs, gathered) + fast(obs, gathered)).sum(), list(fast.parameters()))
    alone = torch.autograd.grad(2 * fast(obs).sum(), list(fast.parameters()))
    for one, other in zip(shared, alone, strict=True):
        torch.testing.assert_close(one, other)


def test_the_same_call_gives_the_same_bits() -> None:
    fast, _ = pair()
    runs = [differentiated(fast, observation(64), torch.float32) for _ in range(2)]
    assert all(torch.equal(one, other) for one, other in zip(*runs, strict=True))


def test_it_stands_aside() -> None:
    """Ablations, other number formats, a kernel that was asked for by name, and tracing for other runtimes."""
    for choice in ("no_sa", "no_ca", "mlp"):
        assert build_encoder(encoder_spec(choice), LAYOUT).op is None
    assert build_encoder(encoder_spec(attention="broadcast"), LAYOUT).op is None
    fast, plain = pair()
    assert fast.double().op is None
    obs = {name: x if x.dtype == torch.bool else x.double() for name, x in observation().items()}
    assert torch.equal(fast(obs), plain(obs))
    exported = torch.export.export(fast.float(), (observation(),), strict=False)
    assert not [node for node in exported.graph.nodes if "Encode" in str(node.target)]


def test_a_machine_without_a_compiler(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CXX", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    source = Path(tmp_path / "nothing.cpp")
    source.write_text("int nothing() { return 0; }\n")
    assert native.library(source) is None
    assert native.library(source) is None
    assert len(caplog.records) == 1
    assert "no C++ compiler found (apt install g++" in caplog.text


def test_sources_that_do_not_compile_are_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = tmp_path / "broken.cpp"
    source.write_text("this is not C++\n")
    assert native.library(source) is None
    assert "broken.cpp" in caplog.text
    assert not list((tmp_path / "cache").rglob("*.so"))


def test_a_library_is_built_once_and_again_for_other_constants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    source = tmp_path / "answer.cpp"
    source.write_text('extern "C" int answer() { return ANSWER; }\n')
    assert [native.library(source, ANSWER=number).answer() for number in (42, 42, 7)] == [42, 42, 7]
    assert len(list((tmp_path / "cache").rglob("*.so"))) == 2
