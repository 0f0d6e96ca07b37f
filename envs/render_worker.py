"""The process that renders: ``python -m envs.render_worker [FOLDER]`` with ``MUJOCO_GL`` set; no folder only tries OpenGL.

The folder holds ``recording.npz`` and ``job.json`` (view, frames, out), written by ``envs.render``. Each frame is
announced by a line "done total". Exit code NO_OPENGL, with the reason as last line of stderr, where the backend is missing.
"""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

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
    job = json.loads((folder / "job.json").read_text())
    with np.load(folder / "recording.npz") as recording:
        pictures = frames(dict(recording), job["view"], job["frames"])
        write(Path(job["out"]), pictures, job["view"]["fps"])
    return 0


def missing_opengl() -> str | None:
    """Why the backend of ``MUJOCO_GL`` cannot be used here, in one line, or None if it can."""
    try:
        import mujoco  # loads the backend's libraries

        context = mujoco.GLContext(16, 16)
        context.make_current()
        context.free()
    except Exception as error:  # a missing library surfaces as ImportError, AttributeError, RuntimeError or a GLError
        return " ".join(str(error).split()) or type(error).__name__
    return None


def frames(recording: dict[str, np.ndarray], view: dict[str, Any], chosen: list[int]) -> Iterator[np.ndarray]:
    """Pictures (height, width, 3) uint8 of the recording's entries ``chosen``, each announced when it is done."""
    from envs.render_scene import Scene

    scene = Scene(recording, view)
    for done, entry in enumerate(chosen, 1):
        yield scene.picture(entry)
        print(done, len(chosen), flush=True)
    scene.close()


def write(out: Path, pictures: Iterator[np.ndarray], fps: int) -> None:
    """Save as .png (the first picture), .gif or .mp4."""
    if out.suffix == ".mp4":
        import imageio.v2

        with imageio.v2.get_writer(out, fps=fps, codec="libx264", quality=7, macro_block_size=1) as film:
            for picture in pictures:
                film.append_data(picture)
        return
    from PIL import Image

    images = (Image.fromarray(picture) for picture in pictures)
    if out.suffix == ".png":
        next(images).save(out)
        return
    first = next(images)
    palette = first.quantize(128)  # one palette for the whole film: no flicker, smaller files
    rest = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    palette.save(out, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else None))
