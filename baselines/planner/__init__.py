"""What trajectory planners share: their view of the world, their clock and messages, and the way to the drones.

A planner is a folder ``baselines/<name>/`` and a YAML file for each of its parameter sets:

1. Its fleet implements :class:`baselines.planner.interface.Fleet`: all drones of one episode, numpy only. Latency,
   link delay and loss come from :mod:`baselines.planner.messages`; budgets are counts, never seconds.
2. Its settings are a frozen dataclass derived from :class:`baselines.planner.agent.PlannerSpec`.
3. Its agent derives from :class:`baselines.planner.agent.PlannerAgent`: ``__init__(self, name, env, spec: OwnSpec)``,
   which hands over to the base class, and ``fleet(task, view, generator)``, called once per episode.
4. ``conf/baseline/<name>.yaml`` holds the published code's parameters: ``defaults: [{tracker: geometric},
   {adapter: default}, _self_]``, ``target: baselines.<name>.agent.<Class>``, the planner's keys and ``deviations``, a
   list of sentences that say where it differs from what was published. ``conf/baseline/<name>_fair.yaml`` has
   ``defaults: [<name>, _self_]`` and the limits and clearances that fit this task; a list given there replaces the
   inherited one, so it states all its deviations. ``conf/baseline/<name>_real.yaml`` fits that to real flights:
   clipped and late commands, noisy poses. Each file is a method of its own: ``--baseline <name>_fair``.

A failure inside a fleet goes to ``Fleet.failures``; an exception ends nothing either: it is recorded in the same way,
and the drones fly on along their last trajectories. ``logging`` at level DEBUG shows its traceback.
"""
