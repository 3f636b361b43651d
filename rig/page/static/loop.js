// The loop in the (T, R) plane: the last hour, the model's branches, and what the film's memory lets one reach.

import { ask } from "./api.js";
import { $, draw, make, say } from "./dom.js";
import { degrees, ohmsShort } from "./format.js";
import { decadeLimits, decades, linear, linearLimits } from "./ticks.js";

const WIDTH = 380, HEIGHT = 400, LEFT = 56, RIGHT = 22, TOP = 10, BOTTOM = 42;
const EVERY_S = 20, FRESH = 120, LONGEST_STEP_S = 5;
const GAP = [null, null]; // nobody read in between: no line is drawn over it
let lastTime = Infinity;
let lastStep_s = 0;
let known = { temperature_degC: [], resistance_ohm: [], model: null, memory: null };
let fresh = []; // live points since the loop was asked for
let target_ohm = null;
let asked = -Infinity;
let drawn = 0;
let lastRow = 0;

/** Whether a live row comes after a gap: later than 5 s, and than three of the steps before. */
function follows(time_s) {
  const between_s = time_s - lastTime;
  const gap = between_s > Math.max(LONGEST_STEP_S, 3 * lastStep_s);
  lastTime = time_s;
  lastStep_s = gap ? 0 : between_s;
  return gap;
}

const finite = (values) => values.filter((value) => Number.isFinite(value));

function scales() {
  const model = known.model;
  const temperatures = finite([...known.temperature_degC, ...(model?.temperature_degC ?? []), ...fresh.map((p) => p[0])]);
  const ohms = finite([...known.resistance_ohm, ...(model?.rising_ohm ?? []), ...(model?.falling_ohm ?? []),
    ...(known.memory?.reachable_ohm ?? []), ...fresh.map((p) => p[1])]).filter((value) => value > 0);
  if (!temperatures.length || !ohms.length) return null;
  const range = (values) => values.reduce(([a, b], v) => [Math.min(a, v), Math.max(b, v)], [Infinity, -Infinity]);
  const [t0, t1] = linearLimits(...range(temperatures), 2);
  const [r0, r1] = decadeLimits(...range(ohms));
  const x = (t) => LEFT + ((t - t0) / (t1 - t0)) * (WIDTH - LEFT - RIGHT);
  const y = (r) => TOP + (Math.log(r1 / r) / Math.log(r1 / r0)) * (HEIGHT - TOP - BOTTOM);
  return { x, y, t: [t0, t1], r: [r0, r1] };
}

function path(scale, temperatures, ohms, kind) {
  let line = "";
  let pen = "M";
  for (let k = 0; k < temperatures.length; k += 1) {
    if (!Number.isFinite(temperatures[k]) || !(ohms[k] > 0)) {
      pen = "M";
      continue;
    }
    line += `${pen}${scale.x(temperatures[k]).toFixed(1)} ${scale.y(ohms[k]).toFixed(1)}`;
    pen = "L";
  }
  return draw("path", { class: kind, d: line || "M0 0" });
}

function axes(scale, svg) {
  for (const t of linear(...scale.t, 5)) {
    svg.append(draw("line", { class: "grid", x1: scale.x(t), x2: scale.x(t), y1: TOP, y2: HEIGHT - BOTTOM }),
      draw("text", { x: scale.x(t), y: HEIGHT - BOTTOM + 17, "text-anchor": "middle" }, String(t).replace("-", "−")));
  }
  for (const r of decades(...scale.r, 4)) {
    svg.append(draw("line", { class: "grid", x1: LEFT, x2: WIDTH - RIGHT, y1: scale.y(r), y2: scale.y(r) }),
      draw("text", { x: LEFT - 7, y: scale.y(r) + 4, "text-anchor": "end" }, ohmsShort(r)));
  }
  svg.append(draw("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 5, "text-anchor": "middle" }, "temperature, °C"));
}

/** What can be reached from the film's memory, on the right edge. */
function reach(scale, svg, [low, high]) {
  const edge = WIDTH - RIGHT + 8;
  const [top, bottom] = [scale.y(high), scale.y(low)];
  svg.append(draw("path", { class: "reach", d: `M${edge} ${top}V${bottom}` }),
    draw("path", { class: "ends", d: `M${edge - 6} ${top}H${edge + 6}M${edge - 6} ${bottom}H${edge + 6}` }));
}

function inWords(memory) {
  if (!memory) return "The film's memory is not known: it is driven to saturation before a model is trusted.";
  const [low, high] = memory.reachable_ohm ?? [null, null];
  const branch = memory.branch === "rising" ? "heating" : memory.branch === "falling" ? "cooling" : memory.branch;
  const where = `Memory: ${branch} branch at ${degrees(memory.temperature_degC)} °C.`;
  return `${where} Within reach now: ${ohmsShort(low)} to ${ohmsShort(high)} (bar on the right).`;
}

function render() {
  drawn = performance.now();
  say($("loop-memory"), inWords(known.memory));
  for (const node of document.querySelectorAll("#loop-key .of-model")) node.hidden = !known.model;
  const scale = scales();
  const place = $("loop-plot");
  if (scale === null) return place.replaceChildren(make("p", { class: "soft" }, "No reading of both in the last hour."));
  const label = `Resistance over temperature, last hour. ${$("loop-memory").textContent}`;
  const svg = draw("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": label });
  axes(scale, svg);
  const { model, memory } = known;
  if (model) {
    svg.append(path(scale, model.temperature_degC, model.rising_ohm, "rising"),
      path(scale, model.temperature_degC, model.falling_ohm, "falling"));
  }
  svg.append(path(scale, known.temperature_degC, known.resistance_ohm, "trail"));
  if (target_ohm > scale.r[0] && target_ohm < scale.r[1]) {
    svg.append(draw("path", { class: "target", d: `M${LEFT} ${scale.y(target_ohm)}H${WIDTH - RIGHT}` }));
  }
  const end = [known.temperature_degC.at(-1), known.resistance_ohm.at(-1)];
  const trace = fresh.length ? fresh : [end];
  svg.append(path(scale, trace.map((p) => p[0]), trace.map((p) => p[1]), "fresh"));
  if (memory?.reachable_ohm?.every((one) => one > 0)) reach(scale, svg, memory.reachable_ohm);
  const [t, r] = trace.at(-1);
  if (Number.isFinite(t) && r > 0) svg.append(draw("circle", { class: "now", cx: scale.x(t), cy: scale.y(r), r: 6.5 }));
  return place.replaceChildren(svg);
}

export async function refreshLoop() {
  asked = performance.now();
  try {
    known = await ask("GET", "/api/loop", undefined, { timeout_s: 20 });
    fresh = fresh.slice(-20);
    while (fresh[0] === GAP) fresh.shift();
    render();
  } catch {
    // asked again by and by
  }
}

/** One live row; drawn at most twice a second. */
export function loopRow(row) {
  const now = performance.now();
  target_ohm = row.target_ohm ?? null;
  if (now - lastRow < 240 || !Number.isFinite(row.temperature_degC) || !(row.resistance_ohm > 0)) return;
  lastRow = now;
  if (follows(row.time_s)) fresh.push(GAP);
  fresh.push([row.temperature_degC, row.resistance_ohm]);
  while (fresh.length > FRESH || fresh[0] === GAP) fresh.shift();
  if (document.hidden) return;
  if (now - asked > EVERY_S * 1000) refreshLoop();
  else if (now - drawn > 500) render();
}
