"""What ``coop-pin view`` does when pictures are asked for."""

from __future__ import annotations

from pathlib import Path


def write_pictures(run: Path, image: Path | None, time: float | None, video: Path | None) -> None:
    """Write an image and a video of a run, whichever is asked for, and print their paths.

    Args:
        run: its folder or result file.
        image: PNG to write.
        time: what it shows, s; the end of the run when omitted.
        video: MP4 to write.

    Raises:
        ResultFileError: the result is missing or damaged.
        MissingExtraError: the extra 'video' is not installed.
        BrowserNotFoundError: there is no browser.
        TimeOutsideRunError: the run does not have that time.
    """
    from coop_pin.results import RunResult
    from coop_pin.run_folder import RunFolder
    from coop_pin.viz import save_image, save_video

    result = RunResult.load(run / RunFolder.RESULT if run.is_dir() else run)
    if image is not None:
        save_image(result, image, time)
        print(image.resolve(), flush=True)
    if video is not None:
        save_video(result, video)
        print(video.resolve())
