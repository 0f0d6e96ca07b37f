"""MAPPO with one actor for all drones and a critic on each drone's own observation (paper, Sec. V-B; method of Yu et
al. 2022 as in the release's `omni_drones/learning/mappo.py`).

Reading order: settings, networks, roll-out, targets, losses, update. What differs from the release is a setting; the
published values stand in `conf/algo/mappo.yaml`:
- an episode cut by the time limit is bootstrapped with the value of its last state (`bootstrap_time_limit`);
- clipped value loss per sample instead of the larger of two batch means (`value_loss`);
- collisions may cost a lump sum of the scalar reward (`hit_penalty`), which the release has in its reward vector.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from algos.arena import Arena
from algos.compilation import Compiler
from algos.gae import advantages
from algos.learner import Learner, Problem, TrainingDiverged, snapshot
from algos.losses import (
    ValueLoss,
    clipped_policy_loss,
    clipped_value_loss,
    gaussian_entropy,
    gaussian_log_prob,
)
from algos.networks import ActorCritic
from algos.policy import Policy
from algos.value_norm import ValueNorm
from envs.spec import Observation
from envs.vocabulary import OBJECTIVES, Weights


@dataclass(frozen=True)
class MappoSpec:
    """Settings of MAPPO (`conf/algo/mappo*.yaml`). Raises ValueError for settings that contradict each other."""

    target: str
    envs: int  # E, episodes flown side by side
    rollout: int  # T, steps between updates
    epochs: int
    minibatches: int  # per epoch
    gamma: float
    gae_decay: float  # lambda
    bootstrap_time_limit: bool
    clip: float  # of the probability ratio
    value_clip: float  # of the critic's change, normalised units
    value_loss: ValueLoss
    huber_delta: float  # normalised units
    policy_loss_scale: float
    entropy: float  # coefficient of the entropy bonus
    actor_learning_rate: float
    critic_learning_rate: float
    final_learning_rate: float  # share of both rates left at the end of a period
    gradient_norm: float  # clip, for each optimiser
    fresh_optimiser: bool  # in every period
    value_norm_decay: float
    value_norm_floor: float  # least variance
    log_std: float  # of the exploration noise at the start
    share_encoder: bool  # between actor and critic
    hits_terminate: bool
    hit_penalty: float  # taken from the scalar reward when an episode terminates
    stagger: bool  # first episodes end at random times
    pool: int  # scenarios drawn at a time
    pool_updates: int  # updates between draws

    def __post_init__(self) -> None:
        if self.envs * self.rollout % self.minibatches:
            raise ValueError(
                f"algo.envs * algo.rollout = {self.envs * self.rollout} does not divide into "
                f"algo.minibatches={self.minibatches}: change one of the three"
            )
        if self.stagger and not self.bootstrap_time_limit:
            raise ValueError("algo.stagger=true cuts episodes short and needs algo.bootstrap_time_limit=true")

    def build(self, problem: Problem, seed: int, compiler: Compiler) -> "Mappo":
        return Mappo(self, problem, seed, compiler)


class Rollout(NamedTuple):
    """T steps of E episodes; values in normalised units."""

    observation: Observation  # every group (T, E, N, ...)
    u: Tensor  # (T, E, N, 4)
    log_prob: Tensor  # (T, E, N)
    value: Tensor  # (T, E, N)
    next_value: Tensor  # (T, E, N) of the state reached, before any reset
    reward: Tensor  # (T, E, N, 4) reward vectors
    terminated: Tensor  # (T, E)
    truncated: Tensor  # (T, E)


class Batch(NamedTuple):
    """Samples of an update; rows are environment steps."""

    observation: Observation
    u: Tensor  # (B, N, 4)
    log_prob: Tensor  # (B, N)
    value: Tensor  # (B, N)
    advantage: Tensor  # (B, N) normalised
    target: Tensor  # (B, N) normalised returns


def utility(reward: Tensor, weights: Weights) -> Tensor:
    """Scalar reward (..., N) of reward vectors (..., N, 4): w . R, the only place where objectives are mixed."""
    return reward @ reward.new_tensor(weights)


class Mappo:
    """The learner (see `algos.learner.Learner`)."""

    def __init__(self, spec: MappoSpec, problem: Problem, seed: int, compiler: Compiler) -> None:
        self.spec, self.weights, self.device = spec, problem.weights, problem.device
        self.replicas = problem.replicas
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.networks = ActorCritic(problem, spec.log_std, spec.share_encoder).to(self.device)
        self.value_norm = ValueNorm(spec.value_norm_decay, spec.value_norm_floor).to(self.device)
        self.generator = torch.Generator().manual_seed(seed)
        self.optimisers = self._fresh_optimisers()
        compiled = self.networks.compiler_for(compiler)
        self.forward = compiled(self.networks.forward)
        self.losses = compiled(self._losses)

    @property
    def policy(self) -> Policy:
        return self.networks.policy

    def start_period(self) -> None:
        """Fresh optimisers where the settings say so (release); weights, noise and normaliser go on."""
        if self.spec.fresh_optimiser:
            self.optimisers = self._fresh_optimisers()

    def inherit(self, other: Learner) -> None:
        """Go on with another learner's policy and noise, and with its critic where both are built alike."""
        if self.networks.inherit(other.networks):
            self.value_norm.adopt(*other.value_scale())

    def adopt(self, policy: Policy) -> None:
        """Go on with a policy trained elsewhere; the critic begins anew."""
        self.networks.adopt(policy)

    def value_scale(self) -> tuple[float, float]:
        """(mean, deviation): returns are mean + deviation * what the critic says."""
        mean, deviation = self.value_norm.statistics()
        return mean.item(), deviation.item()

    def _fresh_optimisers(self) -> list[torch.optim.Adam]:
        """One for the actor and one for the critic, or the actor's for both when they share the encoder."""
        rates = (self.spec.actor_learning_rate, self.spec.critic_learning_rate)
        return [
            torch.optim.Adam(part, rate, fused=True) for part, rate in zip(self.networks.parts(), rates, strict=False)
        ]

    def update(self, arena: Arena, progress: float) -> dict[str, float]:
        """One roll-out and `epochs` passes over it in minibatches."""
        before = snapshot(self.state_dict())
        for optimiser in self.optimisers:
            group = optimiser.param_groups[0]
            group["lr"] = optimiser.defaults["lr"] * (1 + (self.spec.final_learning_rate - 1) * progress)
        try:
            rollout = self._fly(arena)
            batch, facts = self._targets(rollout)
            return facts | self._learn(batch)
        except TrainingDiverged:
            self.load_state_dict(before)
            raise

    @torch.no_grad()
    def _fly(self, arena: Arena) -> Rollout:
        steps: list[tuple[Any, ...]] = []
        cuts: list[tuple[int, Tensor, Observation]] = []
        std = self.policy.log_std.exp()
        for t in range(self.spec.rollout):
            observation = arena.observe()
            mean, value = self.forward(observation)
            noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
            u = mean + std * noise
            outcome = arena.step(u.tanh())
            if self.spec.bootstrap_time_limit and bool(outcome.truncated.any()):
                index = outcome.truncated.nonzero().squeeze(-1)
                final = arena.final_observation()
                cuts.append((t, index, {name: x[index] for name, x in final.items()}))
            log_prob = gaussian_log_prob(noise, self.policy.log_std)
            steps.append((observation, u, log_prob, value, outcome.reward, outcome.terminated, outcome.truncated))
        last = self.forward(arena.observe())[1]
        observations, *rest = zip(*steps, strict=True)
        u, log_prob, value, reward, terminated, truncated = (torch.stack(x) for x in rest)
        next_value = torch.cat((value[1:], last[None]))
        for t, index, final in cuts:
            next_value[t, index] = self.networks.critic(final)
        stacked = {name: torch.stack([x[name] for x in observations]) for name in observations[0]}
        return Rollout(stacked, u, log_prob, value, next_value, reward, terminated, truncated)

    @torch.no_grad()
    def _targets(self, rollout: Rollout) -> tuple[Batch, dict[str, float]]:
        """Advantages and normalised returns; rows flattened over time and environments.

        Of several processes that learn together each gives its own advantages mean 0 and deviation 1; returns are
        normalised by what all of them have seen.
        """
        value = self.value_norm.denormalise(rollout.value)
        done = rollout.terminated | rollout.truncated
        reward = utility(rollout.reward, self.weights) - self.spec.hit_penalty * rollout.terminated.unsqueeze(-1)
        advantage = advantages(
            reward,
            value,
            self.value_norm.denormalise(rollout.next_value),
            rollout.terminated if self.spec.bootstrap_time_limit else done,
            done,
            self.spec.gamma,
            self.spec.gae_decay,
        )
        returns = advantage + value
        self.value_norm.update(returns, self.replicas.mean)
        unexplained = (advantage.var() / returns.var().clamp_min(1e-12)).item()
        means = rollout.reward.mean((0, 1, 2)).tolist()
        facts = {f"learn/{name}": mean for name, mean in zip(OBJECTIVES, means, strict=True)} | {
            "learn/reward": reward.mean().item(),
            "learn/return": returns.mean().item(),
            "learn/explained_variance": 1 - unexplained,
        }
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        rows = Batch(
            {name: x.flatten(0, 1) for name, x in rollout.observation.items()},
            *(
                x.flatten(0, 1)
                for x in (rollout.u, rollout.log_prob, rollout.value, advantage, self.value_norm.normalise(returns))
            ),
        )
        return rows, facts

    def _losses(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Policy loss, value loss, entropy, and what tells how far the policy moved: KL and share of clipped ratios."""
        mean, value = self.networks(batch.observation)
        log_std = self.policy.log_std
        log_prob = gaussian_log_prob((batch.u - mean) / log_std.exp(), log_std)
        spec = self.spec
        policy = clipped_policy_loss(log_prob, batch.log_prob, batch.advantage, spec.clip)
        critic = clipped_value_loss(
            value, batch.value, batch.target, spec.value_clip, spec.huber_delta, spec.value_loss
        )
        log_ratio = (log_prob - batch.log_prob).detach()
        kl = (log_ratio.exp() - 1 - log_ratio).mean()
        clipped = ((log_ratio.exp() - 1).abs() > spec.clip).float().mean()
        return policy, critic, gaussian_entropy(log_std), kl, clipped

    def _learn(self, batch: Batch) -> dict[str, float]:
        names = ("loss/policy", "loss/value", "policy/entropy", "policy/kl", "policy/clipped")
        sums = torch.zeros(len(names))
        parts = self.networks.parts()
        norms = torch.zeros(2)
        count = self.spec.epochs * self.spec.minibatches
        for number, rows in enumerate(self._minibatches(len(batch.u))):
            chosen = Batch({name: x[rows] for name, x in batch.observation.items()}, *(x[rows] for x in batch[1:]))
            losses = self.losses(chosen)
            policy, critic, entropy, *_ = losses
            total = self.spec.policy_loss_scale * policy - self.spec.entropy * entropy + critic
            for optimiser in self.optimisers:
                optimiser.zero_grad()
            total.backward()
            total = self.replicas.average_gradients([x for part in parts for x in part], total)
            norm = [nn.utils.clip_grad_norm_(part, self.spec.gradient_norm) for part in parts]
            if not all(bool(x.isfinite()) for x in (total, *norm)):
                raise TrainingDiverged(self._record(number, dict(zip(names, losses, strict=True))))
            for optimiser in self.optimisers:
                optimiser.step()
            sums += torch.stack([x.detach().cpu() for x in losses]) / count
            norms[: len(norm)] += torch.stack(norm).detach().cpu() / count
        facts = dict(zip(names, sums.tolist(), strict=True))
        facts |= dict(zip(("policy/gradient", "value/gradient"), norms[: len(parts)].tolist(), strict=False))
        return facts | {"policy/std": self.policy.log_std.exp().mean().item()}

    def _minibatches(self, rows: int) -> Iterator[Tensor]:
        """Row numbers of every minibatch of every epoch, shuffled over environments and time."""
        for _ in range(self.spec.epochs):
            order = torch.randperm(rows, generator=self.generator).to(self.device)
            yield from order.chunk(self.spec.minibatches)

    def _record(self, minibatch: int, losses: dict[str, Tensor]) -> dict[str, Any]:
        broken = [
            name
            for name, parameter in self.networks.named_parameters()
            if parameter.grad is not None and not bool(parameter.grad.isfinite().all())
        ]
        return {"minibatch": minibatch, "non_finite_gradients": broken} | {k: x.item() for k, x in losses.items()}

    def state_dict(self) -> dict[str, Any]:
        return {
            "networks": dict(self.networks.state_dict()),
            "value_norm": dict(self.value_norm.state_dict()),
            "optimisers": [optimiser.state_dict() for optimiser in self.optimisers],
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.networks.load_state_dict(state["networks"])
        self.value_norm.load_state_dict(state["value_norm"])
        for optimiser, saved in zip(self.optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(saved)
        self.generator.set_state(state["generator"].cpu())
