"""The encoder's invariances, its two attention kernels, its ablations and the sizes of the release."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from algos.attention import Attention, broadcast_attention, sdpa_attention
from algos.encoder import Encoder, build_encoder
from tests.algos.conftest import LAYOUT, encoder_spec, observation

VARIANTS = ("attention", "no_sa", "no_ca", "mlp", "release")
ANY_NUMBER = ("attention", "no_sa", "release")


def built(choice: str, balls: int = 2, **changes: object) -> Encoder:
    return build_encoder(encoder_spec(choice, **changes), LAYOUT, balls).double()


def doubled(obs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {name: x if x.dtype == torch.bool else x.double() for name, x in obs.items()}


@given(batch=st.integers(1, 4), heads=st.sampled_from([1, 2, 4]), keys=st.integers(1, 7), seed=st.integers(0, 99))
@settings(max_examples=30, deadline=None)
def test_the_two_kernels_agree_in_value_and_gradient(batch: int, heads: int, keys: int, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    q, k, v = (
        torch.randn(batch, n, heads, 8, generator=generator, dtype=torch.float64, requires_grad=True)
        for n in (3, keys, keys)
    )
    present = torch.rand(batch, keys, generator=generator) > 0.5  # rows without any key among them
    results = []
    for kernel in (broadcast_attention, sdpa_attention):
        out = kernel(q, k, v, present)
        results.append((out, *torch.autograd.grad(out.square().sum(), (q, k, v))))
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-10, atol=1e-12)


def test_attention_without_any_key_is_zero() -> None:
    q, k = torch.randn(2, 1, 2, 4), torch.randn(2, 3, 2, 4)
    for kernel in (broadcast_attention, sdpa_attention):
        assert torch.equal(kernel(q, k, k, torch.zeros(2, 3, dtype=torch.bool)), torch.zeros(2, 1, 2, 4))


@pytest.mark.parametrize("choice", VARIANTS)
def test_masked_tokens_change_nothing_and_present_ones_do(choice: str) -> None:
    encoder, obs = built(choice), doubled(observation())
    other = {name: x.clone() for name, x in obs.items()}
    other["dynamic"][~obs["dynamic_mask"]] = 1e3
    other["static"][~obs["static_mask"]] = float("nan")
    assert torch.equal(encoder(obs), encoder(other))
    other["dynamic"][obs["dynamic_mask"]] += 1
    seen = obs["dynamic_mask"].any(-1)
    assert ((encoder(obs) != encoder(other)).any(-1) == seen).all()


@pytest.mark.parametrize("choice", VARIANTS)
def test_gradients_are_finite_when_everything_is_masked(choice: str) -> None:
    encoder, obs = built(choice), doubled(observation())
    obs["dynamic_mask"][:] = False
    obs["static_mask"][:] = False
    out = encoder(obs)
    out.square().sum().backward()
    assert out.isfinite().all()
    assert all(p.grad is None or p.grad.isfinite().all() for p in encoder.parameters())


@pytest.mark.parametrize("choice", ANY_NUMBER)
@given(balls=st.integers(0, 5), drones=st.integers(1, 5), seed=st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_order_of_obstacles_and_drones_does_not_matter(choice: str, balls: int, drones: int, seed: int) -> None:
    encoder, obs = built(choice), doubled(observation(drones=drones, balls=balls, seed=seed))
    generator = torch.Generator().manual_seed(seed)
    order, team = torch.randperm(balls, generator=generator), torch.randperm(drones - 1, generator=generator)
    shuffled = obs | {
        "dynamic": obs["dynamic"][:, :, order],
        "dynamic_mask": obs["dynamic_mask"][:, :, order],
        "drones": obs["drones"][:, :, team],
    }
    torch.testing.assert_close(encoder(obs), encoder(shuffled))


@pytest.mark.parametrize("choice", VARIANTS)
def test_padding_with_absent_balls_changes_nothing(choice: str) -> None:
    encoder, obs = built(choice, balls=4), doubled(observation(balls=2))
    padded = obs | {
        "dynamic": torch.cat((obs["dynamic"], torch.full((5, 3, 2, 10), 7.0, dtype=torch.float64)), 2),
        "dynamic_mask": torch.cat((obs["dynamic_mask"], torch.zeros(5, 3, 2, dtype=torch.bool)), 2),
    }
    torch.testing.assert_close(encoder(obs), encoder(padded))


@pytest.mark.parametrize("choice", ["no_ca", "mlp"])
def test_fixed_encoders_refuse_more_balls_and_say_what_to_do(choice: str) -> None:
    encoder = built(choice)
    assert encoder(doubled(observation(balls=0))).shape == (5, 3, 64)
    with pytest.raises(ValueError, match=rf"encoder={choice} .*at most 2 balls.*encoder=attention .*scenario.balls=3"):
        encoder(doubled(observation(balls=3)))
    with pytest.raises(ValueError, match="built for 3 drones"):
        encoder(doubled(observation(drones=4)))


def test_ablations_use_the_module_they_name_in_place_of_attention() -> None:
    """Without self-attention a far token cannot reach another; without cross-attention the order of balls matters."""
    obs = doubled(observation(absent=False))
    order = obs | {"dynamic": obs["dynamic"].flip(2)}
    for choice in ("no_ca", "mlp"):
        assert not torch.allclose(built(choice)(obs), built(choice)(order))
    moved = obs | {"dynamic": obs["dynamic"] + 1}
    own = {choice: built(choice) for choice in ("no_sa", "attention")}
    halves = {choice: (e(obs)[..., :32], e(moved)[..., :32]) for choice, e in own.items()}
    assert torch.equal(*halves["no_sa"])  # the self token's half never saw the balls
    assert not torch.allclose(*halves["attention"])


def test_kernels_give_the_same_features() -> None:
    one = built("attention", attention="broadcast")
    other = built("attention", attention="sdpa")
    other.load_state_dict(one.state_dict())
    obs = doubled(observation())
    torch.testing.assert_close(one(obs), other(obs))


def test_release_sizes() -> None:
    """Parameter counts of the authors' actor (15,080) and critic (14,881) with their 29 self numbers."""
    encoder = build_encoder(encoder_spec("release"), replace(LAYOUT, self_dim=29))
    count = sum(p.numel() for p in encoder.parameters())
    assert count + 64 * 4 + 4 + 4 == 15_080
    assert count + 64 + 1 == 14_881


def test_width_that_heads_do_not_divide() -> None:
    with pytest.raises(ValueError, match=r"encoder.width=32 .*encoder.heads=5"):
        built("attention", heads=5)


def test_compiled_attention_gives_the_eager_numbers_and_gradients() -> None:
    module = Attention(8, 2, "broadcast")
    tokens = torch.randn(5, 3, 8, requires_grad=True)
    present = torch.tensor([[True, True, True], [False] * 3, [True, False, True], [False, True, True], [True] * 3])
    results = []
    for call in (module, torch.compile(module, dynamic=False, fullgraph=True)):
        out = call(tokens[:, :1], tokens, present)
        results.append((out, *torch.autograd.grad(out.square().sum(), (tokens, *module.parameters()))))
    for eager, compiled in zip(*results, strict=True):
        torch.testing.assert_close(eager, compiled)
