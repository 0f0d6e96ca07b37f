"""Short-horizon actor-critic: back-propagation through the world (Xu et al., ICLR 2022).

The weighted objectives of a short roll-out, and the critic's value of where it ends, are differentiated with respect
to the policy straight through the dynamics. Same world, observations, encoder, objectives and curriculum as MAPPO;
only the estimator of the gradient differs. Indicators (hits) have no gradient: train with `reward=smooth`, whose
penalties are wide and smooth, and let hits not end episodes; what is reported is always the hard metric.

Reading order: settings, roll-out and actor, critic targets, critic.
"""

import copy
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from algos.arena import Arena
from algos.compilation import Compiler
from algos.gae import advantages
from algos.learner import Learner, Problem, TrainingDiverged, snapshot
from algos.mappo import utility
from algos.networks import ActorCritic
from algos.policy import Policy
from envs.spec import Observation, State

RECENT = 5
"""The kept policy is an average over at most one in so many of the updates so far: a young one forgets its start."""


@dataclass(frozen=True)
class ShacSpec:
    """Settings of SHAC (`conf/algo/shac.yaml`)."""

    target: str
    envs: int  # E, episodes flown side by side
    rollout: int  # h, the horizon: steps differentiated through
    gamma: float
    td_decay: float  # lambda of the critic's targets
    actor_learning_rate: float
    critic_learning_rate: float
    final_learning_rate: float  # share of both rates left at the end of a period
    adam_betas: tuple[float, float]  # of the actor
    gradient_norm: float  # clip, for each optimiser
    gradient_outliers: float  # an episode's gradient is cut to this many times the median episode's
    critic_epochs: int
    critic_minibatches: int  # per epoch
    target_rate: float  # share of the critic that enters the target network per update
    policy_rate: float  # share of the policy that enters the one that is kept per update
    return_scale: float  # the critic predicts returns divided by this
    log_std: float  # of the exploration noise at the start
    log_std_range: tuple[float, float]
    fresh_optimiser: bool  # in every period
    hits_terminate: bool
    stagger: bool  # first episodes end at random times
    pool: int  # scenarios drawn at a time
    pool_updates: int  # updates between draws

    def __post_init__(self) -> None:
        if self.envs * self.rollout % self.critic_minibatches:
            raise ValueError(
                f"algo.envs * algo.rollout = {self.envs * self.rollout} does not divide into "
                f"algo.critic_minibatches={self.critic_minibatches}: change one of the three"
            )

    def build(self, problem: Problem, seed: int, compiler: Compiler) -> "Shac":
        return Shac(self, problem, seed, compiler)


class Step(NamedTuple):
    """What one step leaves for the critic, without gradients."""

    observation: Observation  # every group (E, N, ...)
    reward: Tensor  # (E, N) scalar reward
    terminated: Tensor  # (E,)
    truncated: Tensor  # (E,)


class Trajectory(NamedTuple):
    """A roll-out as the critic sees it, without gradients."""

    observation: Observation  # every group (h, E, N, ...)
    reward: Tensor  # (h, E, N) scalar reward
    value: Tensor  # (h, E, N) target network's value of the state acted in, in returns
    next_value: Tensor  # (h, E, N) the same of the state reached, before any reset
    terminated: Tensor  # (h, E)
    truncated: Tensor  # (h, E)


class Shac:
    """The learner (see `algos.learner.Learner`).

    `fast` is what the optimisers move; `networks` are its slow averages: the critic's is the target network, and the
    policy's is the policy that is judged and kept. From one update to the next the fast policy's speed, height and
    size of formation sway around what it has learnt; in its average the sway cancels.
    """

    def __init__(self, spec: ShacSpec, problem: Problem, seed: int, compiler: Compiler) -> None:
        self.spec, self.weights, self.device = spec, problem.weights, problem.device
        self.replicas = problem.replicas
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.fast = ActorCritic(problem, spec.log_std, share_encoder=False).to(self.device)
        self.networks = copy.deepcopy(self.fast).requires_grad_(False)
        self.generator = torch.Generator().manual_seed(seed)
        self.updates = 0
        self.start_period()
        compiled = self.fast.compiler_for(compiler)
        self.act = compiled(self.fast.policy.forward)
        self.value = compiled(self.networks.critic)
        self.critic_loss = compiled(self._critic_loss)

    @property
    def policy(self) -> Policy:
        return self.networks.policy

    def start_period(self) -> None:
        """Fresh optimisers where the settings say so; weights and noise go on."""
        if self.spec.fresh_optimiser or not hasattr(self, "actor"):
            policy, critic = self.fast.parts()
            self.actor = torch.optim.Adam(policy, self.spec.actor_learning_rate, betas=self.spec.adam_betas, fused=True)
            self.critic = torch.optim.Adam(critic, self.spec.critic_learning_rate, fused=True)

    def inherit(self, other: Learner) -> None:
        """Go on with another learner's policy and noise, and with its critic where both are built alike."""
        if self.fast.inherit(other.networks):
            mean, deviation = other.value_scale()
            self.fast.rescale(mean / self.spec.return_scale, deviation / self.spec.return_scale)
        self.networks.load_state_dict(self.fast.state_dict())

    def adopt(self, policy: Policy) -> None:
        """Go on with a policy trained elsewhere; the critic begins anew."""
        self.fast.adopt(policy)
        self.networks.load_state_dict(self.fast.state_dict())

    def value_scale(self) -> tuple[float, float]:
        """(mean, deviation): returns are mean + deviation * what the critic says."""
        return 0.0, self.spec.return_scale

    def update(self, arena: Arena, progress: float) -> dict[str, float]:
        """One horizon: a step of the actor along the gradient through the world, then the critic's."""
        before = snapshot(self.state_dict())
        share = 1 + (self.spec.final_learning_rate - 1) * progress
        self.actor.param_groups[0]["lr"] = self.spec.actor_learning_rate * share
        self.critic.param_groups[0]["lr"] = self.spec.critic_learning_rate * share
        try:
            trajectory, facts = self._improve(arena)
            return facts | self._judge(trajectory)
        except TrainingDiverged:
            self.load_state_dict(before)
            raise
        finally:
            arena.detach()

    def _improve(self, arena: Arena) -> tuple[Trajectory, dict[str, float]]:
        """Fly a horizon with gradients and move the policy along them.

        The objective is the discounted scalar reward; the discount starts again where an episode ends. The target
        network's value is added at the horizon and at time limits, nothing after a crash.
        """
        spec, std = self.spec, self.fast.policy.log_std.exp()
        gain = torch.ones(spec.envs, 1, device=self.device)
        objective = torch.zeros((), device=self.device)
        steps: list[Step] = []
        cuts: list[tuple[int, Tensor]] = []
        arena.differentiate()
        observation = arena.observe()
        gathered = self.fast.policy.gathered()
        for t in range(spec.rollout):
            mean = self.act(observation, gathered)
            noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
            outcome = arena.step((mean + std * noise).tanh())
            limit_gradients(arena.state, spec.gradient_outliers)
            reward = utility(outcome.reward, self.weights)
            objective = objective + (gain * reward).sum()
            steps.append(Step(_detached(observation), reward.detach(), outcome.terminated, outcome.truncated))
            gain = gain * spec.gamma
            if bool(outcome.truncated.any()):
                final = self._returns(arena.final_observation())
                objective = objective + (gain * outcome.truncated[:, None] * final).sum()
                cuts.append((t, final.detach()))
            ended = (outcome.terminated | outcome.truncated)[:, None]
            gain = torch.where(ended, 1.0, gain)
            observation = arena.observe()
        last = self._returns(observation)
        objective = objective + (gain * ~ended * last).sum()
        loss = -objective / (spec.rollout * spec.envs * mean.shape[1])
        facts = self._climb(loss)
        return self._trajectory(steps, cuts, last.detach()), facts

    @torch.no_grad()
    def _trajectory(self, steps: list[Step], cuts: list[tuple[int, Tensor]], last: Tensor) -> Trajectory:
        """The steps side by side; `last` (E, N) is the value of what was seen after them, `cuts` at time limits."""
        observations, *rest = zip(*steps, strict=True)
        reward, terminated, truncated = (torch.stack(x) for x in rest)
        seen = {name: torch.stack([x[name] for x in observations]) for name in observations[0]}
        value = self._returns(seen)
        next_value = torch.cat([value[1:], last[None]])
        for t, final in cuts:
            next_value[t] = torch.where(truncated[t, :, None], final, next_value[t])
        return Trajectory(seen, reward, value, next_value, terminated, truncated)

    def _climb(self, loss: Tensor) -> dict[str, float]:
        self.actor.zero_grad()
        loss.backward()
        parameters = self.fast.parts()[0]
        loss = self.replicas.average_gradients(parameters, loss)
        norm = nn.utils.clip_grad_norm_(parameters, self.spec.gradient_norm)
        if not (bool(loss.isfinite()) and bool(norm.isfinite())):
            raise TrainingDiverged({"loss/actor": loss.item(), "policy/gradient": norm.item()})
        self.actor.step()
        with torch.no_grad():
            self.fast.policy.log_std.clamp_(*self.spec.log_std_range)
        std = self.fast.policy.log_std.exp().mean().item()
        return {"loss/actor": loss.item(), "policy/gradient": norm.item(), "policy/std": std}

    def _returns(self, observation: Observation) -> Tensor:
        """The target network's value (..., N), in returns; differentiable with respect to what is observed."""
        return self.spec.return_scale * self.value(observation)

    def _judge(self, flown: Trajectory) -> dict[str, float]:
        """Fit the critic to TD(lambda) returns, then let the slow networks follow."""
        spec = self.spec
        done = flown.terminated | flown.truncated
        gain = advantages(
            flown.reward, flown.value, flown.next_value, flown.terminated, done, spec.gamma, spec.td_decay
        )
        returns = (gain + flown.value).flatten(0, 1)
        rows = {name: x.flatten(0, 1) for name, x in flown.observation.items()}
        losses = []
        for _ in range(spec.critic_epochs):
            order = torch.randperm(len(returns), generator=self.generator).to(self.device)
            for chosen in order.chunk(spec.critic_minibatches):
                loss = self.critic_loss({k: x[chosen] for k, x in rows.items()}, returns[chosen] / spec.return_scale)
                self.critic.zero_grad()
                loss.backward()
                loss = self.replicas.average_gradients(self.fast.parts()[1], loss)
                nn.utils.clip_grad_norm_(self.fast.parts()[1], spec.gradient_norm)
                if not bool(loss.isfinite()):
                    raise TrainingDiverged({"loss/critic": loss.item()})
                self.critic.step()
                losses.append(loss.item())
        self._follow()
        facts = {"learn/reward": flown.reward.mean().item(), "learn/return": returns.mean().item()}
        return facts | {"loss/critic": sum(losses) / len(losses)}

    def _critic_loss(self, observation: Observation, target: Tensor) -> Tensor:
        return (self.fast.critic(observation) - target).square().mean()

    @torch.no_grad()
    def _follow(self) -> None:
        self.updates += 1
        policy_rate = max(self.spec.policy_rate, RECENT / (RECENT + self.updates))
        rates = (policy_rate, self.spec.target_rate)
        for slow, fast, rate in zip(self.networks.parts(), self.fast.parts(), rates, strict=True):
            for mean, now in zip(slow, fast, strict=True):
                mean.lerp_(now, rate)

    def state_dict(self) -> dict[str, Any]:
        return {
            "networks": dict(self.networks.state_dict()),
            "fast": dict(self.fast.state_dict()),
            "optimisers": [self.actor.state_dict(), self.critic.state_dict()],
            "generator": self.generator.get_state(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.networks.load_state_dict(state["networks"])
        self.fast.load_state_dict(state["fast"])
        for optimiser, saved in zip((self.actor, self.critic), state["optimisers"], strict=True):
            optimiser.load_state_dict(saved)
        self.generator.set_state(state["generator"].cpu())
        self.updates = state["updates"]


def limit_gradients(state: State, most: float) -> None:
    """Cut what flows back through each episode of ``state`` to ``most`` times the median episode's.

    A tumbling drone multiplies gradients at every step; unchecked, one episode decides the direction of the update.
    Of several processes that learn together each has a median of its own.
    """

    def limited(gradient: Tensor | None) -> Tensor | None:
        if gradient is None:  # nothing depends on this field
            return None
        norms = gradient.flatten(1).norm(dim=1)
        share = (most * norms.median() / norms.clamp_min(1e-30)).clamp_max(1)
        return gradient * share.view(-1, *(1,) * (gradient.dim() - 1))

    for field in state:
        if field.requires_grad:
            field.register_hook(limited)


def _detached(observation: Observation) -> Observation:
    return {name: x.detach() for name, x in observation.items()}
