"""Programs made from PyTorch functions: values and gradients against PyTorch's own, operation by operation and for the
pieces of the world."""

from collections.abc import Callable
from typing import Any, NamedTuple

import pytest
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from algos.compilation import Compiler
from envs import memory, scenarios
from envs.episodewise import Episodewise
from envs.formation import FormationEnv
from tests.envs.conftest import make_world

torch.set_num_threads(1)


def plainly(function: Callable[..., Any]) -> Callable[..., Any]:
    """A compiler that leaves functions as they are."""
    return function


def doubled(tree: Any) -> Any:
    """The same numbers with twice the digits."""
    return pytree.tree_map(lambda x: x.double() if x.is_floating_point() else x, tree)


def assert_as_exact(fast: list[Tensor], plain: list[Tensor], exact: list[Tensor]) -> None:
    """No further from the truth than PyTorch in the same number format: ten steps at 2 ms cost digits."""
    for one, other, truth in zip(fast, plain, exact, strict=True):
        if truth.is_floating_point():
            known = truth.isfinite()
            assert torch.equal(one[~known].double(), truth[~known])
            errors = [(x.double() - truth)[known].abs().max().item() if known.any() else 0.0 for x in (one, other)]
            size = truth[known].abs().max().item() if known.any() else 0.0
            assert errors[0] <= 3 * errors[1] + 1e-5 * max(size, 0.1)
        else:
            assert torch.equal(one, other)


def differentiated(function: Callable[..., Any], arguments: tuple[Any, ...], wanted: tuple[int, ...]) -> list[Tensor]:
    """Outputs, then gradients of the wanted arguments."""

    def fresh(x: Tensor) -> Tensor:
        return x.detach().clone().requires_grad_() if x.is_floating_point() else x

    given = [pytree.tree_map(fresh, x) if i in wanted else x for i, x in enumerate(arguments)]
    outputs = pytree.tree_leaves(function(*given))
    generator = torch.Generator().manual_seed(0)
    weighted = [
        (torch.where(x.isfinite(), x, 0.0) * torch.randn(x.shape, generator=generator).to(x)).sum()
        for x in outputs
        if x.requires_grad
    ]
    inputs = [x for i in wanted for x in pytree.tree_leaves(given[i]) if x.is_floating_point()]
    return [*outputs, *torch.autograd.grad(sum(weighted), inputs, materialize_grads=True, allow_unused=True)]


def assert_alike(fast: list[Tensor], plain: list[Tensor]) -> None:
    for one, other in zip(fast, plain, strict=True):
        assert one.dtype == other.dtype
        number = other.is_floating_point() and other.numel()
        size = torch.where(other.isfinite(), other, 0).abs().max().item() if number else 0.0
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5 * max(size, 0.1))


class Numbers(NamedTuple):
    one: Tensor  # (E, 3)
    two: Tensor  # (E, 3)
    count: Tensor  # (E,) int64


def everything(x: Numbers) -> dict[str, Tensor]:
    """Each operation that programs know, once."""
    positive = x.two.abs() + 0.1
    near = x.one.amin(-1) < x.two.amax(-1)
    total = torch.where(near[:, None], x.one.sin() * x.two.cos(), (x.one / positive).exp())
    total = total + positive.sqrt() + positive.rsqrt() + positive.reciprocal() + x.one.clamp(-0.5, 0.5)
    total = total + torch.maximum(x.one, x.two) - torch.minimum(x.one, 0.3 * x.two) + x.one**3 - x.two.square()
    total = total - torch.expm1(-positive) + torch.linalg.cross(x.one, x.two).flip(-1) + x.one.mean(-1, keepdim=True)
    return {
        "total": total,
        "joined": memory.cat((x.one[:, :1], x.two[:, 1:], -x.one)).contiguous(),
        "near": near & ~(x.count > 3) | (x.one > 1).any(-1),
        "count": x.count + 1,
        "as_number": x.count.to(x.one) * near + x.one.sum(-1),
        "untouched": x.two,
    }


@pytest.mark.parametrize("episodes", [1, 8, 13])
@pytest.mark.parametrize("rows", [True, False])
def test_every_operation_and_its_derivative(episodes: int, rows: bool) -> None:
    generator = torch.Generator().manual_seed(episodes)
    one, two = (torch.randn(episodes, 3, generator=generator) for _ in range(2))
    given = Numbers(memory.ordered(one), two, torch.arange(episodes))
    program = Episodewise(everything, plainly, rows=rows)
    assert_alike(differentiated(program, (given,), (0,)), differentiated(everything, (given,), (0,)))
    assert all(kernel is not None for kernel in program.built.values())
    for name, x in program(given).items():
        assert x.is_contiguous() or not rows or name == "untouched"


def test_what_is_not_finite_is_passed_on() -> None:
    one = torch.randn(9, 3)
    one[4, 1] = float("nan")
    found = Episodewise(everything, plainly)(Numbers(one, torch.randn(9, 3), torch.arange(9)))["total"]
    assert found.isnan().any(-1).tolist() == [i == 4 for i in range(9)]


def shrink(x: Numbers, by: Tensor) -> Numbers:
    return x._replace(one=x.one - by * x.one.sin() + 0.1 * x.two, count=x.count + 1)


def test_repeated_steps_and_their_gradient() -> None:
    """The result takes the place of the first argument; the gradient of what stays is summed over the steps."""

    def thrice(x: Numbers, by: Tensor) -> Numbers:
        return shrink(shrink(shrink(x, by), by), by)

    program = Episodewise(shrink, plainly, differentiable=(0, 1))
    given = (Numbers(torch.randn(11, 3), torch.randn(11, 3), torch.zeros(11, dtype=torch.int64)), torch.rand(11, 3))
    fast = differentiated(lambda *x: program(*x, repeat=3), given, (0, 1))
    assert_alike(fast, differentiated(thrice, given, (0, 1)))


def test_what_no_program_can_say_is_left_to_pytorch() -> None:
    program = Episodewise(lambda x: x.sort(-1).values, plainly)
    x = torch.randn(5, 3)
    assert torch.equal(program(x), x.sort(-1).values)
    assert list(program.built.values()) == [None]


@pytest.fixture(scope="module")
def flown() -> tuple[FormationEnv, FormationEnv, Any, Any, Tensor]:
    """A world, the same in C++, and thirteen episodes with balls in the air and drones off their hover."""
    plain = FormationEnv(make_world("scenario=mixed", "reward=smooth", "scenario.throw_time=[0.2,0.6]"))
    drawn = scenarios.sample(plain.world.scenario, 13, 0)
    state = plain.reset(drawn)
    generator = torch.Generator().manual_seed(0)
    action = torch.tensor([0, 0, 0, 0.04]) + 0.1 * torch.randn(13, 3, 4, generator=generator)
    with torch.no_grad():
        for _ in range(25):
            state, _, _ = plain.step(state, action, drawn)
    assert 0 < state.ball_time.isinf().sum() < state.ball_time.numel()
    return plain, plain.compiled(Compiler(True)), state, drawn, action


def test_observations_are_pytorchs(flown: tuple[FormationEnv, FormationEnv, Any, Any, Tensor]) -> None:
    plain, fast, state, drawn, _ = flown
    results = [differentiated(lambda s, env=env: env.observe(s, drawn), (state,), (0,)) for env in (fast, plain)]
    assert_alike(*results)
    assert all(x.is_contiguous() for x in fast.observe(state, drawn).values())


@pytest.mark.parametrize("latency", [0.0, 0.007])
def test_steps_are_pytorchs(flown: tuple[FormationEnv, FormationEnv, Any, Any, Tensor], latency: float) -> None:
    """A whole step, rewards and events with it; a late command shares the control period with the one before."""
    _, _, state, drawn, action = flown
    world = make_world("scenario=mixed", "reward=smooth", "scenario.throw_time=[0.2,0.6]", f"drone.latency={latency}")
    plain = FormationEnv(world)
    fast = plain.compiled(Compiler(True))
    exact = FormationEnv(world, torch.float64)
    given = (state, action, drawn)
    fast_numbers, plain_numbers = (differentiated(env.step, given, (0, 1)) for env in (fast, plain))
    assert_as_exact(fast_numbers, plain_numbers, differentiated(exact.step, doubled(given), (0, 1)))
    assert all(kernel is not None for piece in fast.programs for kernel in getattr(fast, piece).built.values())


def test_a_disabled_compiler_and_other_number_formats_leave_the_world_alone() -> None:
    world = make_world("scenario=free")
    assert not isinstance(FormationEnv(world).compiled(Compiler(False)).observe, Episodewise)
    assert not isinstance(FormationEnv(world, torch.float64).compiled(Compiler(True)).observe, Episodewise)
