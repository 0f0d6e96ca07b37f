"""Compiling ahead of time: ``formctl doctor --warm`` fills the cache that trainings, trials and evaluations share."""

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from algos import compilation
from algos.trainer import Trainer
from formctl.console import duration, progress, say
from formctl.doctor import compiled_code
from formctl.errors import RunFailed
from formctl.settings import build

if TYPE_CHECKING:
    from formctl.settings import Config


def warm(config: "Config") -> None:
    """Compile what a training with these settings needs. Raises RunFailed where nothing can be compiled."""
    build.use_threads(config)
    settings = replace(build.training(config), compile=True)
    begun = time.monotonic()
    with progress("compile", len(settings.curriculum.periods), "periods") as bar:

        def compiling(name: str, ready: int, pieces: int) -> None:
            bar.preparing(f"{name}, {ready} of {pieces} pieces ready")

        trainer = Trainer(settings, compiling=compiling)
        for period in trainer.warm():
            bar.advance(period)
    if not trainer.compiler.enabled:
        raise RunFailed("nothing was compiled: see the warning above, and formctl doctor")
    say(f"compiled {trainer.compiler.pieces} pieces in {duration(time.monotonic() - begun)}: {compiled_code()}")
    say(f"trainings with these settings start within seconds; rm -r {compilation.cache_folder()} forgets it")
