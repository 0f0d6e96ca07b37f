"""The world under the interfaces that learning libraries know: Gymnasium, PettingZoo and TorchRL.

Their constructors take a :class:`envs.formation.FormationEnv`; ``formctl.environments`` builds one from the name of a
scenario. Each module needs its library installed.
"""
