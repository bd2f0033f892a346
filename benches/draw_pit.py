#!/usr/bin/env python3
"""Draws one moment of a trace as SVG: the server's ball pit, and the copy of one client beside it.

The colour of a copied ball says how far off it is, as a share of its tolerance. Draws balls only; walls of the ball pit are circles.

    pip install mcap mcap-protobuf-support
    rhumb-bench evaluate --bodies 500 --seconds 5 --modes integrated,rhumb --no-limit
    python3 benches/draw_pit.py results/trace.mcap docs/pit.svg --tick 150
"""

import argparse

from check_trace import STATIC, Truth, gather, read, surface_error

WIDTH, HEIGHT, SCALE = 480, 400, 20.0
# The camera looks down at an angle: depth is shortened, height is almost kept.
DEPTH, RISE = 0.42, 0.9
WALL_RADII, WALL_HEIGHT = (10.0,), 5.0
GREY, NEAR, FAR = (107, 114, 128), (191, 219, 254), (194, 65, 12)


def moment(path, mode, tick):
    """The truth and one mode's run at a tick, and the run's frame that shows it."""
    records, topics = read(path)
    load = next(name for name in topics if name.endswith("/truth/state")).split("/")[1]
    run = next(run for run in gather(records, topics, load) if run.config["name"] == mode)
    truth = Truth()
    for _, states in topics[f"/{load}/truth/state"]:
        truth.step(states)
        run.advance(truth, states.tick)
        if states.tick == tick:
            return truth, run
    raise SystemExit(f"the trace has no tick {tick}")


def project(x, y, z):
    """The place of a point in a panel."""
    return WIDTH / 2 + SCALE * x, 0.68 * HEIGHT + SCALE * (DEPTH * z - RISE * y)


def mix(share):
    share = min(max(share, 0.0), 1.0)
    return "#%02x%02x%02x" % tuple(round(a + (b - a) * share) for a, b in zip(NEAR, FAR))


def wall(radius):
    """A round wall: its lower and upper edge."""
    edges = []
    for height in (0.0, WALL_HEIGHT):
        x, y = project(0.0, height, 0.0)
        edges.append(f'<ellipse cx="{x:.0f}" cy="{y:.0f}" rx="{SCALE * radius:.0f}" ry="{SCALE * DEPTH * radius:.0f}"/>')
    return "".join(edges)


def panel(left, title, balls):
    """One picture of the pit; balls are (pose, radius, colour)."""
    parts = [f'<svg x="{left}" y="0" width="{WIDTH}" height="{HEIGHT}"><rect width="100%" height="100%" fill="#fff"/>']
    parts.append('<g fill="none" stroke="#d1d5db">' + "".join(map(wall, WALL_RADII)) + '</g><g stroke="#374151" stroke-width="0.6">')
    for pose, radius, colour in sorted(balls, key=lambda ball: (ball[0][2], ball[0][1])):
        x, y = project(*pose[:3])
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{SCALE * radius:.1f}" fill="{colour}"/>')
    parts.append(f'</g><text x="12" y="26" font-family="sans-serif" font-size="17" fill="#111827">{title}</text></svg>')
    return "".join(parts)


def draw(truth, run, tick):
    tolerance = float(run.config["tolerance_m"])
    real, copied, worst = [], [], 0.0
    for body, pose in truth.pose.items():
        _, kind, radius, scale = truth.config[body]
        shown = run.copy.get(body, truth.began[body])
        if kind == STATIC or shown is None:
            continue
        error = surface_error(pose, shown, radius)
        worst = max(worst, error)
        real.append((pose, radius, "#%02x%02x%02x" % GREY))
        copied.append((shown, radius, mix(error / (tolerance * scale))))
    seconds = tick * float(run.config["step_s"])
    said = f"{len(real)} balls after {seconds:.1f} s. Colour: distance from the truth, from 0 to {100 * tolerance:g} cm; the largest is {100 * worst:.1f} cm."
    # One height of text below the panels.
    total = HEIGHT + 32
    text = f'<text x="12" y="{HEIGHT + 20}" font-family="sans-serif" font-size="15" fill="#374151">{said}</text>'
    size = f'width="{2 * WIDTH}" height="{total}" viewBox="0 0 {2 * WIDTH} {total}"'
    background = '<rect width="100%" height="100%" fill="#fff"/>'
    panels = panel(0, "the server's pit", real) + panel(WIDTH, "a client's copy", copied)
    return f'<svg role="img" {size} xmlns="http://www.w3.org/2000/svg">{background}{panels}{text}</svg>\n'


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("trace")
    parser.add_argument("out")
    parser.add_argument("--mode", default="rhumb")
    parser.add_argument("--tick", type=int, default=150)
    arguments = parser.parse_args()
    truth, run = moment(arguments.trace, arguments.mode, arguments.tick)
    with open(arguments.out, "w", encoding="utf8") as file:
        file.write(draw(truth, run, arguments.tick))


if __name__ == "__main__":
    main()
