"""The process that renders: ``python -m envs.render_worker [FOLDER]`` with ``MUJOCO_GL`` set; no folder: a mere try.

The folder holds ``recording.npz`` and ``job.json`` (view, frames, out), written by ``envs.render``, and receives the
file ``out``. Each frame is announced by a line "done total". Exit code NO_OPENGL, with the reason as last line of
stderr, where the backend is missing.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from envs.render_scene import Scene

NO_OPENGL = 3
"""Exit code where the chosen OpenGL backend cannot be used."""


def main(folder: Path | None) -> int:
    """Render the job in ``folder``; the exit code."""
    reason = missing_opengl()
    if reason is not None:
        print(reason, file=sys.stderr)
        return NO_OPENGL
    if folder is None:
        return 0
    from envs.render_scene import Scene

    job = json.loads((folder / "job.json").read_text())
    with np.load(folder / "recording.npz") as recording:
        scene = Scene(dict(recording), job["view"])
    write = {".png": write_png, ".gif": write_gif, ".mp4": write_mp4}[Path(job["out"]).suffix]
    write(folder / job["out"], scene, job["frames"], job["view"]["fps"])
    scene.close()
    return 0


def missing_opengl() -> str | None:
    """Why the backend of ``MUJOCO_GL`` cannot be used here, in one line, or None if it can."""
    try:
        import mujoco  # loads the backend's libraries

        mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16).close()
    except Exception as error:  # a missing library surfaces as ImportError, AttributeError, RuntimeError or a GLError
        return " ".join(str(error).split()) or type(error).__name__
    return None


def frames(scene: "Scene", chosen: list[int]) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) uint8 of the recording's entries ``chosen``, each announced when it is done."""
    for done, entry in enumerate(chosen, 1):
        yield scene.picture(entry)
        print(done, len(chosen), flush=True)


def write_png(out: Path, scene: "Scene", chosen: list[int], fps: int) -> None:
    """Save the one chosen picture."""
    from PIL import Image

    for picture in frames(scene, chosen):
        Image.fromarray(picture).save(out)


def write_gif(out: Path, scene: "Scene", chosen: list[int], fps: int) -> None:
    """Save the film as a GIF with one palette, taken from samples of the whole film: no flicker, small files."""
    from PIL import Image

    samples = [scene.picture(entry) for entry in chosen[:: max(1, len(chosen) // 8)]]
    palette = Image.fromarray(np.concatenate(samples)).quantize(255)
    images = (
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in frames(scene, chosen)
    )
    next(images).save(out, save_all=True, append_images=images, duration=round(1000 / fps), loop=0)


def write_mp4(out: Path, scene: "Scene", chosen: list[int], fps: int) -> None:
    """Save the film as H.264."""
    import imageio.v2

    film: Any = imageio.v2.get_writer(out, fps=fps, codec="libx264", quality=7, macro_block_size=2)
    with film:
        for picture in frames(scene, chosen):
            film.append_data(picture)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else None))
