"""What stands over the scene: legend, player, what is done at the moment shown, views and switches."""

import json
from dataclasses import dataclass
from html import escape

import numpy as np

from scanmotion.planning.plan import Plan
from scanmotion.report.figures import palette

LEFT_OUT = "part/left_out"
"""Branch of the scene's tree with the viewpoints that no operation serves; a switch shows it."""
NOT_WORTH_COLOUR = "#a6761d"


@dataclass(frozen=True, eq=False, kw_only=True)
class Views:
    """Where the reader's eye can stand: eye and target in W, shape (3,) each [m]."""

    object_view: tuple[np.ndarray, np.ndarray]
    cell_view: tuple[np.ndarray, np.ndarray]


def views_of(plan: Plan) -> Views:
    """The object large, and the whole cell, both from the side of the table.

    Args:
        plan: whose cell and part are shown.
    """
    base, table = plan.cell.X_WB[:3, 3], plan.cell.X_WT[:3, 3]
    low, high = plan.part.bounds
    foot = plan.cell.X_WT[:3, 3] + plan.cell.X_TO[:3, 3]
    middle = foot + [0.0, 0.0, float(low[2] + high[2]) / 2]
    size = max(0.35, float(np.linalg.norm(high - low)))
    # Somewhat towards the robot, so that the scanner at its standoff is in the picture.
    aside = (base - table) / max(1e-9, float(np.linalg.norm(base - table)))
    target = middle + 0.35 * size * aside
    return Views(
        object_view=(target + size * np.array([0.1, -2.1, 0.75]), target),
        cell_view=(table + [0.25, -2.4, 1.15], 0.63 * table + 0.37 * base + [0.0, 0.0, 0.45]),
    )


_OVERLAY = """
<style>#sm{position:fixed;left:12px;top:12px;font:13px/1.5 system-ui,sans-serif;color:#222;
background:#ffffffd9;padding:.6em .9em;border-radius:6px;max-width:23em}#sm b{font-weight:600}
#sm i{display:inline-block;width:.8em;height:.8em;margin-right:.5em;border-radius:2px}
.dg.main{display:none}
#sm-now{font-variant-numeric:tabular-nums}#sm input{width:14em;vertical-align:middle}</style>
<div id="sm"><b>%(title)s</b><br>%(numbers)s
<div><button id="sm-play">pause</button>
<input id="sm-at" type="range" min="0" max="%(seconds)s" step="0.05"></div>
<div id="sm-now"></div>
<div><button id="sm-object">object</button> <button id="sm-cell">whole cell</button></div>
%(switch)s%(legend)s</div>
<script>
// scene.html#t=12 opens the scene at rest at 12 s, #view=cell with the whole cell in view, #left-out with the
// viewpoints that are not served.
(function () {
  const steps = %(steps)s, find = id => document.getElementById(id);
  const play = find("sm-play"), at = find("sm-at"), now = find("sm-now");
  let asked = /t=([0-9.]+)/.exec(location.hash);
  function hold(a, t) { a.pause(); a.seek(t); a.display_progress(t); }
  at.addEventListener("input", () => hold(viewer.animator, Number(at.value)));
  play.addEventListener("click", () => {
    const a = viewer.animator;
    if (a.playing) a.pause(); else a.play();
  });
  // The tree of the scene has z up, the camera y.
  const views = %(views)s, cameras = name => {
    const [eye, target] = views[name].map(([x, y, z]) => [x, z, -y]);
    viewer.camera.position.set(...eye);
    viewer.controls.target.set(...target);
    viewer.controls.update();
    viewer.set_dirty();
  };
  find("sm-object").addEventListener("click", () => cameras("object"));
  find("sm-cell").addEventListener("click", () => cameras("cell"));
  const lost = find("sm-lost"), show = () => {
    viewer.scene_tree.find(["drake", ..."%(left_out)s".split("/")]).object.visible = lost.checked;
    viewer.set_dirty();
  };
  if (lost) lost.addEventListener("change", show);
  let waited = 0;
  function open_as_asked() {
    // Meshcat sets its own camera while it loads.
    if (++waited !== 4) return;
    if (/view=cell/.test(location.hash)) cameras("cell");
    if (lost && /left-out/.test(location.hash)) { lost.checked = true; show(); }
  }
  // Labels face the reader and keep their size on the screen.
  function labels(node, found) {
    for (const [name, child] of Object.entries(node.children)) {
      if (/(label|name)$/.test(name)) found.push(child.object);
      labels(child, found);
    }
    return found;
  }
  let shown = "";
  function face() {
    requestAnimationFrame(face);
    if (typeof viewer === "undefined" || !viewer.animator) return;
    const c = viewer.camera, state = c.matrixWorld.elements.join() + viewer.animator.time;
    if (state === shown) return;
    shown = state;
    const Q = c.quaternion.constructor, V = c.position.constructor, eye = c.getWorldPosition(new V());
    const turn = c.getWorldQuaternion(new Q()).multiply(new Q(-Math.SQRT1_2, 0, 0, Math.SQRT1_2));
    for (const o of labels(viewer.scene_tree, [])) {
      o.quaternion.copy(o.parent.getWorldQuaternion(new Q()).invert().multiply(turn));
      o.scale.setScalar(o.getWorldPosition(new V()).distanceTo(eye) / 2.4);
    }
    viewer.set_dirty();
  }
  face();
  setInterval(function () {
    const a = typeof viewer === "undefined" ? null : viewer.animator;
    if (!a) return;
    open_as_asked();
    if (!a.actions.length) return;
    if (asked) { hold(a, Number(asked[1])); asked = null; }
    const t = a.time, step = steps.find(s => t < s[1]) || steps[steps.length - 1];
    if (a.playing || document.activeElement !== at) at.value = t;
    play.textContent = a.playing ? "pause" : "play";
    if (step) now.textContent = t.toFixed(1) + " s  " + step[2];
  }, 100);
})();
</script>
"""


def _legend(plan: Plan) -> list[tuple[str, str]]:
    """Words and colours of what is in the scene."""
    entries = list(zip(palette.STATUS_NAMES, palette.STATUS_COLOURS, strict=True))
    entries = [("not seen yet", palette.NOT_YET), *entries] if plan.samples is not None else []
    kinds = dict.fromkeys(o.kind for o in plan.trajectory.operations) if plan.trajectory is not None else {}
    entries += [(f"path: {kind}", palette.OPERATION_COLOURS[kind]) for kind in kinds]
    entries += [("field of view (while scanning)", "#f2a33a")]
    posed = {v.id for v in plan.viewpoints}
    if posed & {name for name, _ in plan.unreachable}:
        entries.append(("viewpoint out of reach", palette.CAUSE_COLOURS["out_of_reach"]))
    if posed & {name for name, _ in plan.not_worth}:
        entries.append(("viewpoint not worth its seconds", NOT_WORTH_COLOUR))
    return entries


def with_overlay(page: str, plan: Plan) -> str:
    """The page with a legend, the numbers, and what is being done at the moment shown.

    Args:
        page: of Meshcat.
        plan: that it shows.
    """
    time = 0.0 if plan.trajectory is None else plan.trajectory.duration
    done = None if plan.summary is None else plan.summary.completeness.final
    numbers = f"{time:.1f} s" + ("" if done is None else f", {done:.2%} of what can be seen")
    legend = "<br>".join(f'<i style="background:{c}"></i>{escape(name)}' for name, c in _legend(plan))
    steps = [
        (o.t_start, o.t_end, f"{o.kind} {' '.join(o.viewpoints)}")
        for o in (plan.trajectory.operations if plan.trajectory is not None else ())
    ]
    views = views_of(plan)
    lost = len({name for name, _ in plan.left_out} & {v.id for v in plan.viewpoints})
    words = f"viewpoint{'s' if lost > 1 else ''} left out"
    switch = f'<label><input id="sm-lost" type="checkbox" style="width:auto"> {lost} {words}</label>'
    told = {"object": [v.tolist() for v in views.object_view], "cell": [v.tolist() for v in views.cell_view]}
    overlay = _OVERLAY % {
        "title": escape(plan.part.name),
        "numbers": escape(numbers),
        "legend": f"<div>{legend}</div><div>axes: red x, green y, blue z</div>",
        "switch": switch if lost else "",
        "left_out": LEFT_OUT,
        "views": json.dumps(told),
        "seconds": f"{time:.2f}",
        # A "<" in a name must not be able to end or open a script element.
        "steps": json.dumps(steps).replace("<", "\\u003c"),
    }
    head, end, tail = page.rpartition("</body>")
    return head.replace("<title>Drake MeshCat</title>", "<title>scanmotion</title>") + overlay + end + tail
