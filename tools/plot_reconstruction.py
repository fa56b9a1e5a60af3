# SPDX-License-Identifier: Apache-2.0
"""Plots of the Poisson solver for docs/papers/manzi2016.md; `./dev bench reconstruction --images docs/images` calls it.

Curves are the theory of [Manzi 2016, Eq. 4], computed here by quadrature; points are what the solver does with white
noise, as bench/poisson_bench measured it.
"""
import math

PRIMAL, GRADIENT, ALPHA = 0.01, 0.0004, 0.2  # variances of the data and weight of the primal rows, as in the paper
STEPS = 64  # of the quadrature in each direction
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 640, 380, 64, 150, 20, 48
COLORS = {"green": "#2a8a4a", "red": "#c0392b", "black": "#222222", "blue": "#2c6fbb", "orange": "#c77700"}


def power(frequency):
    """|D|^2 of a difference at a frequency in cycles a sample."""
    return 2 - 2 * math.cos(2 * math.pi * frequency)


SPATIAL = [power((k + 0.5) / STEPS) for k in range(STEPS)]
SPATIAL_SUMS = [x + y for x in SPATIAL for y in SPATIAL]


def error(frequency, temporal, mixed, ratio=1.0):
    """Mean squared error at a temporal frequency, averaged over spatial ones."""
    t, total = power(frequency), 0.0
    for s in SPATIAL_SUMS:
        rows = t * (temporal + mixed * s)
        total += (ALPHA**4 * PRIMAL + GRADIENT * (s + ratio * rows)) / (ALPHA**2 + s + rows) ** 2
    return total / len(SPATIAL_SUMS)


class Plot:
    """Axes with curves and points; values are mapped by `sx` and `sy` from [0, 1] of the data's range."""

    def __init__(self, x_range, y_range, x_label, y_label, x_ticks, y_ticks, log_x=False, log_y=False):
        self.x_range, self.y_range, self.log_x, self.log_y = x_range, y_range, log_x, log_y
        self.parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
            'font-family="sans-serif" font-size="13">',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#ffffff"/>']
        bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
        for v in x_ticks:
            x = self.x(v)
            self.parts.append(f'<line x1="{x:.1f}" y1="{TOP}" x2="{x:.1f}" y2="{bottom}" stroke="#e4e4e4"/>')
            self.parts.append(f'<text x="{x:.1f}" y="{bottom + 18}" text-anchor="middle" fill="#444">{v:g}</text>')
        for v in y_ticks:
            y = self.y(v)
            self.parts.append(f'<line x1="{LEFT}" y1="{y:.1f}" x2="{right}" y2="{y:.1f}" stroke="#e4e4e4"/>')
            self.parts.append(f'<text x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end" fill="#444">{v:g}</text>')
        self.parts.append(f'<path d="M{LEFT} {TOP}V{bottom}H{right}" fill="none" stroke="#444"/>')
        middle_x, middle_y = (LEFT + right) / 2, (TOP + bottom) / 2
        self.parts.append(f'<text x="{middle_x}" y="{HEIGHT - 10}" text-anchor="middle" fill="#222">{x_label}</text>')
        self.parts.append(f'<text transform="translate(16 {middle_y}) rotate(-90)" text-anchor="middle" '
                          f'fill="#222">{y_label}</text>')
        self.labels = []

    @staticmethod
    def place(v, low, high, log):
        return (math.log(v / low) / math.log(high / low)) if log else (v - low) / (high - low)

    def x(self, v):
        return LEFT + self.place(v, *self.x_range, self.log_x) * (WIDTH - LEFT - RIGHT)

    def y(self, v):
        return HEIGHT - BOTTOM - self.place(v, *self.y_range, self.log_y) * (HEIGHT - TOP - BOTTOM)

    def curve(self, points, color, label, dash=""):
        d = "M" + "L".join(f"{self.x(a):.1f} {self.y(b):.1f}" for a, b in points)
        dashes = f' stroke-dasharray="{dash}"' if dash else ""
        self.parts.append(f'<path d="{d}" fill="none" stroke="{COLORS[color]}" stroke-width="2"{dashes}/>')
        self.labels.append([self.y(points[-1][1]), self.x(points[-1][0]), label, color])

    def dots(self, points, color):
        for a, b in points:
            self.parts.append(f'<circle cx="{self.x(a):.1f}" cy="{self.y(b):.1f}" r="3.2" fill="#fff" '
                              f'stroke="{COLORS[color]}" stroke-width="1.6"/>')

    def write(self, path):
        self.labels.sort()
        for i in range(1, len(self.labels)):  # labels at the ends of curves keep a line's distance
            self.labels[i][0] = max(self.labels[i][0], self.labels[i - 1][0] + 16)
        for y, x, label, color in self.labels:
            self.parts.append(f'<text x="{x + 8:.1f}" y="{y + 4:.1f}" fill="{COLORS[color]}">{label}</text>')
        path.write_text("\n".join(self.parts) + "\n</svg>\n")


def frequency_plot():
    return Plot((0, 0.5), (0, 0.45), "temporal frequency, cycles a frame", "mean squared error, thousandths",
                [0, 0.1, 0.2, 0.3, 0.4, 0.5], [0, 0.1, 0.2, 0.3, 0.4])


def plot_theory(columns, folder):
    """`columns`: what `poisson_bench --theory` prints."""
    grid = [k / 200 for k in range(101)]

    def measured(name, scale):
        values = columns[name]["solver"]["at"]
        return [(0.05 * k, scale * v) for k, v in enumerate(values)]

    # Equal time: the temporal method has two passes of half the samples, so all of its data have twice the variance.
    plot = frequency_plot()
    for name, temporal, mixed, scale, color, label in (
            ("independent, spatial rows", 0, 0, 1, "green", "spatial only"),
            ("independent, first order", 1, 0, 2, "red", "with dt"),
            ("independent, c = 1", 1, 1, 2, "black", "with dt, dxdt, dydt")):
        plot.curve([(f, 1e3 * scale * error(f, temporal, mixed)) for f in grid], color, label)
        plot.dots(measured(name, scale), color)
    plot.write(folder / "reconstruct-frequency.svg")

    plot = frequency_plot()
    plot.curve([(f, 1e3 * error(f, 0, 0)) for f in grid], "green", "spatial only")
    for ratio, color in ((0.5, "blue"), (1, "black"), (1.5, "orange"), (2, "red")):
        plot.curve([(f, 2e3 * error(f, 1, 1, ratio)) for f in grid], color, f"c = {ratio:g}")
        plot.dots(measured(f"independent, c = {ratio:g}", 2), color)
    plot.write(folder / "reconstruct-ratio.svg")


def plot_convergence(run, folder):
    """`run`: what `poisson_bench --schedules fast,published` prints."""
    curves = {name: [(p[1], p[2]) for p in s["curve"] if p[1] > 0] for name, s in run["schedules"].items()}
    last = max(p[0] for c in curves.values() for p in c)
    plot = Plot((0.02, 1.1 * last), (0.007, 0.2), "processor seconds", "RMS error to the truth",
                [v for v in (0.1, 1, 10, 100) if v < last], [0.01, 0.02, 0.05, 0.1, 0.2], log_x=True, log_y=True)
    for name, color, label in (("fast", "black", "default"), ("published", "red", "published")):
        plot.curve([p for p in curves[name] if p[0] >= 0.02], color, label)
    plot.write(folder / "reconstruct-convergence.svg")
