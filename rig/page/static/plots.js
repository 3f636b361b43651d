// Three plots over one time axis, drawn by uPlot; gestures of mouse, touch and keyboard become changes of the window.

import { $ } from "./dom.js";
import { heater } from "./glance.js";
import { amperes, day, degrees, ohmsShort, share, timeOfDay } from "./format.js";
import { decadeLimits, decades, linear, linearLimits, times } from "./ticks.js";

const AXIS = 62;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const short = (value) => String(Number(value.toPrecision(6))).replace("-", "−");

export const PLOTS = [
  { key: "temperature", column: "temperature_degC", wanted: "setpoint_degC", height: 158, least: 0.5,
    text: (v) => `${degrees(v)} °C` },
  { key: "current", column: "current_A", wanted: null, height: 118, least: 0.05, text: (v) => (heater() ? `${share(v)} of full` : `${amperes(v)} A`) },
  { key: "resistance", column: "resistance_ohm", wanted: "target_ohm", height: 196, log: true, text: ohmsShort },
];

/** Words of the time axis: as fine as its steps, the day where it changes. */
function timeWords(splits) {
  const step_s = splits.length > 1 ? splits[1] - splits[0] : 1;
  let before = null;
  return splits.map((time_s) => {
    if (time_s === null) return null;
    const date = day(time_s);
    const changed = date !== before;
    before = date;
    if (step_s >= 86400) return date;
    const text = timeOfDay(time_s, step_s < 60);
    return changed ? `${text}\n${date}` : text;
  });
}

function options(plot, last, width, hooks) {
  const own = colour(plot.key);
  const grid = { stroke: colour("line"), width: 1 };
  const font = "12px system-ui, sans-serif";
  const axis = { stroke: colour("soft"), grid, ticks: { show: false }, font };
  return {
    width, height: plot.height - (last ? 0 : 22), legend: { show: false }, padding: [6, 10, last ? 0 : 4, 0],
    scales: {
      x: { time: true, auto: false },
      y: plot.log
        ? { distr: 3, range: (_, low, high) => decadeLimits(low, high) }
        : { range: (_, low, high) => (low === null ? [0, 1] : linearLimits(low, high, plot.least)) },
    },
    axes: [
      { ...axis, size: last ? 40 : 0, splits: (u, _, low, high) => times(low, high, u.width / 84)[0],
        values: (_, splits) => (last ? timeWords(splits) : splits.map(() => null)) },
      { ...axis, size: AXIS, gap: 6,
        splits: (u, _, low, high) => (plot.log ? decades(low, high) : linear(low, high, u.height > 130 ? 5 : 3)),
        filter: (_, splits) => splits, values: (_, splits) => splits.map(plot.log ? ohmsShort : short) },
    ],
    series: [{}, { stroke: colour("wanted"), width: 1.4, dash: [5, 4], points: { show: false } },
      { stroke: own, width: 0, points: { show: false } }, { stroke: own, width: 0, points: { show: false } },
      { stroke: own, width: 1.6, points: { show: false } }],
    bands: [{ series: [2, 3], fill: `${own}38` }],
    cursor: { y: false, sync: { key: "bench", filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" } },
      drag: { x: true, y: false, setScale: false },
      points: { show: (u, k) => (k === 4 ? undefined : false) }, bind: { dblclick: () => () => hooks.live() } },
    hooks: { setSelect: [hooks.select], setCursor: [hooks.cursor] },
  };
}

/** The three plots. `window` has from_s and to_s; `move(from_s, to_s)`, `live()` and `point(index)` are told. */
export class Plots {
  constructor(window_, { move, live, point }) {
    this.window = window_;
    this.hooks = {
      live,
      select: (u) => {
        if (u.select.width < 4) return;
        const from_s = u.posToVal(u.select.left, "x");
        const to_s = u.posToVal(u.select.left + u.select.width, "x");
        u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        move(from_s, to_s);
      },
      cursor: (u) => point(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null),
    };
    this.move = move;
    this.charts = [];
    this.tables = PLOTS.map(() => [[], [], [], [], []]);
    this.build();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
    new ResizeObserver(() => this.resize()).observe($("plots"));
  }

  width() {
    return Math.max(200, Math.floor($("plots").clientWidth));
  }

  build() {
    this.charts.forEach((chart) => chart.destroy());
    this.charts = PLOTS.map((plot, k) => {
      const place = $(`plot-${plot.key}`).querySelector(".plot");
      const last = k === PLOTS.length - 1;
      const chart = new window.uPlot(options(plot, last, this.width(), this.hooks), this.tables[k], place);
      this.gestures(chart.over);
      return chart;
    });
    this.show();
  }

  resize() {
    const width = this.width();
    this.charts.forEach((chart) => chart.width !== width && chart.setSize({ width, height: chart.height }));
  }

  /** Draw the window anew; with tables where the data has changed. */
  show(tables = null) {
    if (tables !== null) this.tables = tables;
    this.charts.forEach((chart, k) => chart.batch(() => {
      if (tables !== null) chart.setData(tables[k], false);
      chart.setScale("x", { min: this.window.from_s, max: this.window.to_s });
    }));
  }

  /** Drag with a finger, pinch with two; a wheel only sideways, so that the page still scrolls. */
  gestures(over) {
    const fingers = new Map();
    const seconds = (px) => (px / over.clientWidth) * (this.window.to_s - this.window.from_s);
    const at = (x) => this.window.from_s + seconds(x - over.getBoundingClientRect().left);
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "mouse") fingers.set(event.pointerId, event.clientX);
    });
    over.addEventListener("pointermove", (event) => {
      if (!fingers.has(event.pointerId)) return;
      const before = [...fingers.values()];
      fingers.set(event.pointerId, event.clientX);
      const after = [...fingers.values()];
      const { from_s, to_s } = this.window;
      if (after.length === 1) {
        const shift = seconds(before[0] - after[0]);
        if (shift) this.move(from_s + shift, to_s + shift);
      } else if (after.length === 2) {
        const wide = Math.max(10, Math.abs(after[0] - after[1]));
        const ratio = Math.max(10, Math.abs(before[0] - before[1])) / wide;
        const middle = at((after[0] + after[1]) / 2);
        this.move(middle - (middle - from_s) * ratio, middle + (to_s - middle) * ratio);
      }
    });
    for (const end of ["pointerup", "pointercancel", "pointerleave"]) {
      over.addEventListener(end, (event) => fingers.delete(event.pointerId));
    }
    over.addEventListener("wheel", (event) => {
      const { from_s, to_s } = this.window;
      if (event.ctrlKey) {
        const ratio = Math.exp(event.deltaY * 0.01);
        const middle = at(event.clientX);
        event.preventDefault();
        this.move(middle - (middle - from_s) * ratio, middle + (to_s - middle) * ratio);
      } else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
        event.preventDefault();
        this.move(from_s + seconds(event.deltaX), to_s + seconds(event.deltaX));
      }
    }, { passive: false });
  }
}
