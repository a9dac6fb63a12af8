"""What slack costs: how much less a local station sees where it gives way, by the simulator's visibility.

    python benchmarks/slack.py [--stations 60] [--seed 0]

Stations round the built-in carving look at its surface from 0.6 to 0.85 m. Each is moved to the edge of its
slack: tilted about the aimed point to four sides, at the least and the greatest distance. Said is, of the
samples that the exact pose sees, the share that the moved one does not (lost), and new ones in their place
(gained). Exit status 1 where the default slack loses more than 2 % in the mean.
"""

import argparse
import sys

import numpy as np

from scanmotion.cell.build import build_cell
from scanmotion.cell.settings.cell import load_cell
from scanmotion.core.viewpoint import Slack, Viewpoint, look_at
from scanmotion.geometry.parts.make_part import carving, surface_samples
from scanmotion.motion.reach.slack import variants
from scanmotion.sensing.visibility import scene_from, seen_by_any
from scanmotion.views.next_best_views import LOCAL_SLACK


def main() -> int:
    asked = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    asked.add_argument("--stations", type=int, default=60)
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    settings, part = load_cell("kr240"), carving()
    cell, scanner = build_cell(settings, part), settings.scanner_model()
    rng = np.random.default_rng(given.seed)
    scene = scene_from(part.vertices, part.triangles, table_radius=settings.turntable.diameter_m / 2)
    samples = surface_samples(part, 20_000, rng=rng)
    aims = rng.choice(len(samples.points), given.stations, replace=False)
    default = round(float(np.rad2deg(LOCAL_SLACK.tilt)), 3), LOCAL_SLACK.standoff[1]
    kept = True
    for tilt, along in dict.fromkeys((default, (1.0, 0.005), (2.0, 0.01), (3.0, 0.02), (5.0, 0.05))):
        lost, gained = [], []
        for n, i in enumerate(aims):
            p, out, standoff = samples.points[i], samples.normals[i], 0.6 + 0.25 * n / len(aims)
            if out[2] < -0.3:
                continue
            view = Viewpoint(
                id="L", X_OS=look_at(p + standoff * out, -out), standoff=standoff, step="local",
                kind="station", slack=Slack(standoff=(-along, along), tilt=np.deg2rad(tilt), roll=False),
            )  # fmt: skip
            exact = seen_by_any(scene, scanner, view.X_OS[None], samples.points, samples.normals)
            if exact.sum() < 100:
                continue
            # The last twelve are at the edge: four sides, three distances each.
            for other in variants(cell, view)[-12:]:
                seen = seen_by_any(scene, scanner, other.X_OS[None], samples.points, samples.normals)
                lost.append((exact & ~seen).sum() / exact.sum())
                gained.append((seen & ~exact).sum() / exact.sum())
        net = float(np.mean(gained) - np.mean(lost))
        print(
            f"{tilt:g} deg, {1e3 * along:g} mm: {len(lost)} poses, lost {np.mean(lost):.2%} in the mean, "
            f"{np.percentile(lost, 95):.2%} at the 95th percentile; gained {np.mean(gained):.2%}, "
            f"net {net:+.2%}"
        )
        if (tilt, along) == default:
            kept = float(np.mean(lost)) <= 0.02
    return int(not kept)


if __name__ == "__main__":
    sys.exit(main())
