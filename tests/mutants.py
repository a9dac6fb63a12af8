"""Mutated programmes and what the judge misses of them: shared by the tests of every format."""

import shutil

import numpy as np
from mutations import KINDS, mutated
from scipy.spatial import cKDTree

from scanmotion.core.errors import PlanFileError
from scanmotion.judge.programme.check import verify_programme
from scanmotion.judge.programme.controller import controller_from
from scanmotion.judge.programme.world import ScriptedScanner

AWAY_DEG, LATER_S, LATER = 0.35, 0.5, 0.01
"""What is harmless: joints no farther from the good programme's path, and no later than this."""


def run_of(file, folder):
    """A run with a scanner that answers at once, and the variables after it."""
    controller = controller_from(file, folder)
    return controller.run(ScriptedScanner(signals=controller.signals))


def missed(file, folder, tmp_path, count, seed, language):
    """Mutated programmes in which nothing was found and that do something else: the words on them.

    Args:
        file: the good programme's main file, alone with its other files in a folder.
        folder: of its plan.
        tmp_path: where the mutated ones are written.
        count: how many.
        seed: of where the faults are.
        language: krl, rapid or urscript.

    Returns:
        words on those that are missed, and on all in which nothing was found.
    """
    names = [
        p.name
        for p in sorted(file.parent.iterdir())
        if p.suffix in (".src", ".dat", ".mod", ".script", ".st")
    ]
    for name in names:
        shutil.copy(file.parent / name, tmp_path / name)
    others = [n for n in names if n != file.name]
    good, _ = run_of(file, folder)
    rng, left, wrong, tried, n = np.random.default_rng(seed), [], [], 0, 0
    while tried < count:
        n += 1
        path = tmp_path / (others[n // 9 % len(others)] if others and n % 9 == 0 else file.name)
        data = path.read_bytes()
        made = mutated(data.decode().replace("\r\n", "\n").split("\n"), KINDS[n % len(KINDS)], rng, language)
        if made is None:
            continue
        tried += 1
        path.write_bytes("\r\n".join(made[0]).encode())
        try:
            if not verify_programme(tmp_path / file.name, folder, clearance=False).findings:
                left.append(made[1])
                run, _ = run_of(tmp_path / file.name, folder)
                if not harmless(run, good):
                    wrong.append(made[1])
        except PlanFileError:
            pass
        path.write_bytes(data)
    return wrong, left


def harmless(run, good):
    """Near the good programme: path and times, and the same outputs, steps and messages in the same order."""
    told = [_told(r) for r in (run, good)]
    return (
        run.ended
        and told[0] == told[1]
        and cKDTree(good.q).query(run.q, p=np.inf)[0].max() < AWAY_DEG
        and cKDTree(run.q).query(good.q, p=np.inf)[0].max() < AWAY_DEG
        and abs(len(run.said("pulse")) - len(good.said("pulse"))) <= 3
        and abs(run.t[-1] - good.t[-1]) < LATER_S + LATER * good.t[-1]
    )


def _told(run):
    """What changes in the outside world: an output that is told its own state again changes nothing."""
    found, state = [], {}
    for e in run.events:
        if e.kind == "output":
            if state.get(e.number, False) != e.on:
                found.append((e.number, e.on))
            state[e.number] = e.on
        elif e.kind in ("word", "step", "halt", "brake"):
            found.append((e.kind, e.number))
    return found
