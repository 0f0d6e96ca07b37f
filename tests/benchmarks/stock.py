"""The yardstick of ``tests.benchmarks.learners``: MAPPO as TorchRL's own pieces make it, on the same task and network.

Collector, GAE, ClipPPOLoss and a sampler without replacement, put together as in TorchRL's multi-agent tutorial; world,
encoder, batch sizes, epochs and coefficients are those of ``algo=mappo*``. Nothing of it is compiled.
"""

from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from algos.encoder import build_encoder
from algos.mappo import MappoSpec
from algos.trainer import TrainSettings
from envs.dynamics import hover_command
from envs.formation import FormationEnv
from envs.interfaces.torchrl_env import TorchRLFormationEnv

GROUPS = ("self", "drones", "static", "dynamic", "static_mask", "dynamic_mask")
VALUE, LOG_PROB = ("agents", "state_value"), ("agents", "sample_log_prob")


class Head(nn.Module):
    """The attention encoder and a linear layer, called with the observation groups in the order of GROUPS."""

    def __init__(self, settings: TrainSettings, env: FormationEnv, out: int) -> None:
        super().__init__()
        kind = replace(settings.encoder, attention="broadcast")  # vmap, which the modules use, slows the fused kernel
        self.encoder = build_encoder(kind, env.layout, settings.world.scenario.balls)
        self.head = nn.Linear(self.encoder.features, out)
        nn.init.xavier_uniform_(self.head.weight, gain=0.01)

    def forward(self, *groups: Tensor) -> Tensor:
        """(..., N, out)."""
        return self.head(self.encoder(dict(zip(GROUPS, groups, strict=True))))


class Actor(Head):
    """Mean and spread (..., N, 4) of the command before tanh."""

    def __init__(self, settings: TrainSettings, env: FormationEnv, log_std: float) -> None:
        super().__init__(settings, env, 4)
        with torch.no_grad():
            self.head.bias.copy_(torch.tensor([0.0, 0.0, 0.0, hover_command(settings.world.drone)]).atanh())
        self.log_std = nn.Parameter(torch.full((4,), log_std))

    def forward(self, *groups: Tensor) -> Any:
        mean = super().forward(*groups)
        return mean, self.log_std.exp().expand_as(mean)


class Stock:
    """TorchRL's MAPPO; ``update()`` flies one roll-out and learns from it."""

    def __init__(self, settings: TrainSettings) -> None:
        """``settings.algo`` is a MAPPO."""
        assert isinstance(settings.algo, MappoSpec)
        self.algo = settings.algo
        self.frames = self.algo.envs * self.algo.rollout
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(settings.seed)
            world = FormationEnv(settings.world)
            self.env = TorchRLFormationEnv(
                world, self.algo.envs, settings.seed, settings.weights, flat=False, block=self.algo.pool
            )
            seen = [("agents", "observation", name) for name in GROUPS]
            self.actor = Actor(settings, world, self.algo.log_std)
            self.policy = ProbabilisticActor(
                TensorDictModule(self.actor, seen, [("agents", "loc"), ("agents", "scale")]),
                in_keys=[("agents", "loc"), ("agents", "scale")],
                out_keys=[self.env.action_key],
                distribution_class=TanhNormal,
                return_log_prob=True,
                log_prob_key=LOG_PROB,
            )
            critic = TensorDictModule(Head(settings, world, 1), seen, [VALUE])
        self.loss = self._loss(critic)
        self.optimiser = torch.optim.Adam(self.loss.parameters(), self.algo.actor_learning_rate)
        self.collector = Collector(
            self.env,
            self.policy,
            frames_per_batch=self.frames,
            total_frames=-1,
            auto_register_policy_transforms=False,
        )
        self.flown = iter(self.collector)
        self.buffer = ReplayBuffer(
            storage=LazyTensorStorage(self.frames),
            sampler=SamplerWithoutReplacement(),
            batch_size=self.frames // self.algo.minibatches,
        )

    def _loss(self, critic: TensorDictModule) -> ClipPPOLoss:
        loss = ClipPPOLoss(
            actor_network=self.policy,
            critic_network=critic,
            clip_epsilon=self.algo.clip,
            entropy_coeff=self.algo.entropy,
            normalize_advantage=True,
        )
        loss.set_keys(
            reward=self.env.reward_keys[0],
            action=self.env.action_key,
            value=VALUE,
            sample_log_prob=LOG_PROB,
            done=("agents", "done"),
            terminated=("agents", "terminated"),
        )
        loss.make_value_estimator(ValueEstimators.GAE, gamma=self.algo.gamma, lmbda=self.algo.gae_decay)
        return loss

    def update(self) -> int:
        """One roll-out and all epochs over it; environment steps done."""
        batch = next(self.flown)
        with torch.no_grad():
            self._estimate(batch)
        self.buffer.extend(batch.reshape(-1))
        for _ in range(self.algo.epochs * self.algo.minibatches):
            terms = self._losses(self.buffer.sample())
            sum(terms[key] for key in ("loss_objective", "loss_critic", "loss_entropy")).backward()
            nn.utils.clip_grad_norm_(self.loss.parameters(), self.algo.gradient_norm)
            self.optimiser.step()
            self.optimiser.zero_grad()
        self.collector.update_policy_weights_()
        return self.frames

    def _losses(self, rows: TensorDictBase) -> TensorDictBase:
        return self.loss(rows)

    def _estimate(self, batch: TensorDictBase) -> None:
        """Advantages and value targets; every drone ends when its team does."""
        shape = batch.get_item_shape(("next", *self.env.reward_keys[0]))
        for key in ("done", "terminated"):
            flag = batch.get(("next", key)).unsqueeze(-1).expand(shape)
            batch.set(("next", "agents", key), flag)
        self.loss.value_estimator(
            batch, params=self.loss.critic_network_params, target_params=self.loss.target_critic_network_params
        )
