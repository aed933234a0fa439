"""Progress of runs, recorded, and results folders of runs, altered."""

from contextlib import contextmanager

from mic.results.parquet import read_table, write_table
from mic.results.schema import CONTACTS, MEASUREMENTS, RESOLUTIONS, SAMPLES, SLIPS
from mic.runs import Progress


def changed(scene, **tables):
    """The scene with other keys in some of its tables."""
    return scene.model_copy(update={name: getattr(scene, name).model_copy(update=tables[name]) for name in tables})


class RecordedProgress(Progress):
    """Records the sentences of a run; may interrupt it after a number of blocks."""

    def __init__(self, stop_after=None):
        self.sentences, self.remaining = [], stop_after

    def report(self, sentence):
        self.sentences.append(sentence)

    @contextmanager
    def sampling(self, laws, samples):
        yield self.advance

    def advance(self, law, count):
        if self.remaining is not None:
            self.remaining -= 1
            if self.remaining == 0:
                raise KeyboardInterrupt


class NoPictures:
    """Stands for the pictures that a run draws in the background."""

    def __init__(self, outcome):
        pass

    def end(self):
        pass


def skip_pictures(replace):
    """Write reports without pictures; `replace` is ``setattr`` or that of a monkeypatch."""
    from mic.commands import run  # imports matplotlib, which most tests do without
    from mic.report import comparison_page, explanation_page, page

    replace(comparison_page, "comparison_pictures", lambda *_: [])
    replace(explanation_page, "explanation_pictures", lambda *_: [])
    replace(page, "draw_all", lambda *_: {})
    replace(run, "BackgroundPictures", NoPictures)


def edit(folder, table, law, change):
    """Rewrite every block of a table with what `change` makes of its frame."""
    for path in sorted((folder / table.name / f"law={law}").glob("*.parquet")):
        frame, identity = read_table(path, table)
        write_table(path, table, change(frame), identity)


def fail(folder, law, reasons):
    """Mark samples as failed in one stage, with NaN for all that they hold.

    Parameters
    ----------
    reasons : dict of int to (str, str)
        By number of the sample: the stage that failed, and its status.
    """

    def failed(frame):
        return frame.assign(failed=frame["failed"] | frame["sample"].isin(list(reasons)))

    def unresolved(frame):
        frame = frame.astype({"status": object})
        for number, (stage, status) in reasons.items():
            hit = (frame["sample"] == number) & (frame["stage"] == stage)
            frame.loc[hit, ["residual", "status", "converged"]] = [float("nan"), status, False]
        return frame.astype({"status": "category", "converged": bool})

    def emptied(frame):
        names = [name for name in frame if frame[name].dtype.kind == "f"]
        frame.loc[frame["sample"].isin(list(reasons)), names] = float("nan")
        return frame

    edit(folder, SAMPLES, law, failed)
    edit(folder, RESOLUTIONS, law, unresolved)
    for table in (SLIPS, MEASUREMENTS, CONTACTS):
        edit(folder, table, law, emptied)


def all_fail(folder, law, samples, stage="clamp", status="not converged"):
    """Mark all samples of a run as failed."""
    fail(folder, law, dict.fromkeys(range(samples), (stage, status)))
