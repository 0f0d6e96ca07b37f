"""Multi-agent PPO from TorchRL's own pieces on the TorchRL interface: a team learns to fly in formation.

    python examples/ppo_torchrl.py --out free.pt2        # learns, writes the policy
    formctl eval --policy free.pt2 scenario=free         # flies it like any other method

Collector, MultiAgentMLP, GAE, ClipPPOLoss and a replay buffer without replacement, put together as in TorchRL's
multi-agent tutorial: actors with shared parameters, a central critic (MAPPO).
"""

import argparse
import json
import time
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.data.replay_buffers.samplers import SamplerWithoutReplacement
from torchrl.envs import TransformedEnv
from torchrl.envs.transforms import RewardScaling
from torchrl.modules import MLP, MultiAgentMLP, ProbabilisticActor, TanhNormal
from torchrl.objectives import ClipPPOLoss, ValueEstimators

from baselines import exported
from formctl import environments

ENVS, ROLLOUT, EPOCHS, MINIBATCHES = 128, 32, 4, 8
GAMMA, TRACE, CLIP, LEARNING_RATE, GRADIENT_NORM = 0.99, 0.95, 0.2, 1e-3, 0.5
REWARD_SCALE = 0.1
SEEN, VALUE, LOG_PROB = ("agents", "observation"), ("agents", "state_value"), ("agents", "sample_log_prob")


def actor_of(env: TransformedEnv) -> ProbabilisticActor:
    """Drones that decide alone, with one network."""
    drones, width = env.observation_spec[SEEN].shape[-2:]
    network = nn.Sequential(
        MultiAgentMLP(width, 8, drones, centralized=False, share_params=True, depth=2, num_cells=64),
        NormalParamExtractor(scale_mapping="biased_softplus_0.5"),
    )
    with torch.no_grad():
        for weight in list(network.parameters())[-2:]:
            weight.mul_(0.01)  # first commands hover
    return ProbabilisticActor(
        TensorDictModule(network, [SEEN], [("agents", "loc"), ("agents", "scale")]),
        in_keys=[("agents", "loc"), ("agents", "scale")],
        out_keys=[env.action_key],
        distribution_class=TanhNormal,
        return_log_prob=True,
        log_prob_key=LOG_PROB,
    )


def critic_of(env: TransformedEnv) -> TensorDictModule:
    """One value for each drone, of what all of them see."""
    drones, width = env.observation_spec[SEEN].shape[-2:]
    network = MultiAgentMLP(width, 1, drones, centralized=True, share_params=True, depth=2, num_cells=64)
    return TensorDictModule(network, [SEEN], [VALUE])


class Flown(nn.Module):
    """The actor as it flies: vectors (B, N, d) to commands (B, N, 4), the tanh of the mean."""

    def __init__(self, actor: ProbabilisticActor) -> None:
        super().__init__()
        shared = actor[0].module[0]
        self.network = MLP(shared.n_agent_inputs, shared.n_agent_outputs, depth=2, num_cells=64)
        shared.params.to_module(self.network)

    def forward(self, seen: Tensor) -> Tensor:
        return self.network(seen)[..., :4].tanh()


def train(
    steps: int, seed: int, log: Path | None, envs: int = ENVS
) -> tuple[ProbabilisticActor, list[dict[str, float]]]:
    """Learn for ``steps`` steps of all teams together; the actor and the curve."""
    torch.manual_seed(seed)
    teams = environments.make_torchrl("free", envs, ["reward=shaped"], seed=seed)
    (reward,) = [key for key in teams.reward_keys if key[-1] == "reward"]
    env = TransformedEnv(teams, RewardScaling(0.0, REWARD_SCALE, in_keys=[reward]))
    actor, critic = actor_of(env), critic_of(env)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=CLIP, entropy_coeff=0.0, normalize_advantage=True)
    loss.set_keys(
        reward=reward,
        action=env.action_key,
        value=VALUE,
        sample_log_prob=LOG_PROB,
        done=("agents", "done"),
        terminated=("agents", "terminated"),
    )
    loss.make_value_estimator(ValueEstimators.GAE, gamma=GAMMA, lmbda=TRACE)
    optimiser = torch.optim.Adam(loss.parameters(), LEARNING_RATE, eps=1e-5)
    frames, updates = envs * ROLLOUT, max(1, steps // (envs * ROLLOUT))
    buffer = ReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=frames // MINIBATCHES
    )
    collector = Collector(
        env, actor, frames_per_batch=frames, total_frames=frames * updates, auto_register_policy_transforms=False
    )
    curve, began = [], time.monotonic()
    for update, batch in enumerate(collector):
        optimiser.param_groups[0]["lr"] = LEARNING_RATE * (1 - update / updates)
        estimate(loss, batch, reward)
        buffer.extend(batch.reshape(-1))
        for _ in range(EPOCHS * MINIBATCHES):
            terms = loss(buffer.sample())
            sum(terms[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), GRADIENT_NORM)
            optimiser.step()
            optimiser.zero_grad()
        collector.update_policy_weights_()
        curve.append(
            {
                "steps": (update + 1) * frames,
                "minutes": (time.monotonic() - began) / 60,
                "reward": batch["next", *reward].mean().item() / REWARD_SCALE,
                "crashes_per_minute": batch["next", "terminated"].sum().item() / (frames * teams.env.dt / 60),
            }
        )
        if log is not None:
            log.write_text("".join(json.dumps(row) + "\n" for row in curve))
        if update % 10 == 0 or update == updates - 1:
            print("  ".join(f"{key} {number:,.2f}" for key, number in curve[-1].items()), flush=True)
    collector.shutdown()
    return actor, curve


def estimate(loss: ClipPPOLoss, batch: TensorDictBase, reward: tuple[str, str]) -> None:
    """Advantages and value targets; every drone ends when its team does."""
    shape = batch.get_item_shape(("next", *reward))
    for name in ("done", "terminated"):
        batch.set(("next", "agents", name), batch.get(("next", name)).unsqueeze(-1).expand(shape))
    with torch.no_grad():
        loss.value_estimator(batch, params=loss.critic_network_params, target_params=loss.target_critic_network_params)


def main() -> None:
    """Train, and write the policy where ``--out`` says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=300_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--envs", type=int, default=ENVS)
    parser.add_argument("--log", type=Path, help="learning curve, one line of JSON per update")
    parser.add_argument("--out", type=Path, help="policy, ending in .pt2")
    given = parser.parse_args()
    torch.set_num_threads(1)
    actor, curve = train(given.steps, given.seed, given.log, given.envs)
    if given.out is not None:
        env, _ = environments.make_world("free")
        facts = {"name": "ppo_torchrl", "algo": "mappo", "steps": curve[-1]["steps"], "seed": given.seed}
        exported.save(given.out, Flown(actor), env, facts)
        print(f"policy: {given.out}; fly it: formctl eval --policy {given.out} scenario=free")


if __name__ == "__main__":
    main()
