// History: which stretch of time is shown, fetching it with points that fit, following what is live.

import { ask } from "./api.js";
import { $, sayOrHide } from "./dom.js";
import { day, timeOfDay } from "./format.js";
import { PLOTS, Plots } from "./plots.js";
import { Series } from "./series.js";

const LEAST_S = 5;
const view = { from_s: 0, to_s: 1, span: 600, live: true };
const series = new Series();
let clock_s = 0; // the bench's clock minus this device's
let plots = null;
let fetching = null;
let timer = null;
let drawn = 0;
let fetched = 0;
let first_s = null; // of everything that is kept
let dirty = true;

const now_s = () => Date.now() / 1000 + clock_s;
const span_s = () => view.to_s - view.from_s;

/** Keep the bench's clock: a phone's may be wrong. */
export const setClock = (time_s) => {
  if (Number.isFinite(time_s)) clock_s = time_s - Date.now() / 1000;
};

function follow() {
  if (!view.live) return;
  const end_s = Math.max(now_s(), series.time_s.at(-1) ?? 0);
  const wide = view.span === "all" ? end_s - (first_s ?? end_s - 3600) : view.span;
  view.to_s = end_s;
  view.from_s = end_s - Math.max(LEAST_S, wide);
}

async function fetchNow() {
  fetching?.abort();
  const mine = (fetching = new AbortController());
  $("history").dataset.busy = "";
  const points = Math.min(2000, Math.max(150, plots.width()));
  const get = (from_s, to_s, count) => {
    const query = new URLSearchParams({ from: from_s.toFixed(3), to: to_s.toFixed(3), points: count });
    return ask("GET", `/api/history?${query}`, undefined, { signal: mine.signal, timeout_s: 30 });
  };
  try {
    if (view.live && view.span === "all" && first_s === null) {
      const whole = await get(0, now_s() + 1, points);
      first_s = whole.time_s?.[0] ?? now_s() - 3600;
    }
    follow();
    const margin = view.live ? 0 : span_s() * 0.25; // a little beside the window, so that a drag shows something
    const from_s = Math.max(0, view.from_s - margin);
    const to_s = view.to_s + margin + (view.live ? 1 : 0);
    const answer = await get(from_s, to_s, Math.round(points * (view.live ? 1 : 1.5)));
    if (mine.signal.aborted) return;
    series.take(answer, span_s() / points);
    fetched = performance.now();
    dirty = true;
    draw();
  } catch {
    if (!mine.signal.aborted) fetched = performance.now() - 50_000; // again in ten seconds
  } finally {
    if (fetching === mine) {
      fetching = null;
      delete $("history").dataset.busy;
    }
  }
}

/** Fetch the window soon; many changes in a row make one request. */
export function refetch(wait_ms = 0) {
  clearTimeout(timer);
  timer = setTimeout(fetchNow, wait_ms);
}

function draw() {
  follow();
  drawn = performance.now();
  plots.show(dirty ? PLOTS.map((plot) => series.table(plot.column, plot.wanted, Boolean(plot.log))) : null);
  dirty = false;
  mark();
}

function mark() {
  for (const button of $("ranges").children) {
    const span = button.dataset.span === "all" ? "all" : Number(button.dataset.span);
    button.setAttribute("aria-pressed", String(view.live && view.span === span));
  }
  $("moves").querySelector("[data-move=live]").setAttribute("aria-pressed", String(view.live));
}

/** Show another stretch; one that reaches the present follows it. */
function move(from_s, to_s) {
  const latest_s = now_s();
  const wide = Math.max(LEAST_S, to_s - from_s);
  view.live = false;
  view.to_s = Math.min((from_s + to_s) / 2 + wide / 2, latest_s + wide * 0.05);
  view.from_s = view.to_s - wide;
  plots.show();
  mark();
  refetch(200);
}

function live(span = null) {
  if (span !== null) view.span = span;
  else if (!view.live && view.span !== "all") view.span = Math.max(60, span_s());
  view.live = true;
  follow();
  draw();
  refetch();
}

const ACTIONS = {
  earlier: () => move(view.from_s - span_s() / 2, view.to_s - span_s() / 2),
  later: () => move(view.from_s + span_s() / 2, view.to_s + span_s() / 2),
  in: () => move(view.from_s + span_s() / 4, view.to_s - span_s() / 4),
  out: () => move(view.from_s - span_s() / 2, view.to_s + span_s() / 2),
  live: () => live(),
};
const KEYS = { ArrowLeft: "earlier", ArrowRight: "later", "+": "in", "=": "in", "-": "out", End: "live" };

/** The values under the cursor, in words. */
function point(time_s) {
  if (time_s === null || !series.time_s.length) return sayOrHide($("readout"), null);
  let k = series.time_s.findIndex((one) => one >= time_s);
  if (k < 0) k = series.time_s.length - 1;
  if (k > 0 && time_s - series.time_s[k - 1] < series.time_s[k] - time_s) k -= 1;
  const at = series.time_s[k];
  const values = PLOTS.map((plot) => plot.text(series.columns[plot.column].mean[k]));
  return sayOrHide($("readout"), `${day(at)} ${timeOfDay(at)}   ${values.join("   ")}`);
}

/** One live row. */
export function historyRow(row) {
  if (!view.live) return;
  series.add(row);
  dirty = true;
}

function tick() {
  if (document.hidden || !view.live || fetching !== null) return;
  const since = performance.now() - drawn;
  if (since > (span_s() <= 7200 ? 240 : 2000)) {
    series.trim(view.from_s - span_s() * 0.2);
    draw();
  }
  if (performance.now() - fetched > Math.max(60, 2 * series.bucket_s) * 1000) fetchNow();
}

export function setUpHistory() {
  follow();
  plots = new Plots(view, { move, live: () => live(600), point });
  $("ranges").addEventListener("click", ({ target }) => {
    if (target.dataset.span) live(target.dataset.span === "all" ? "all" : Number(target.dataset.span));
  });
  $("moves").addEventListener("click", ({ target }) => ACTIONS[target.dataset.move]?.());
  $("plots").addEventListener("keydown", (event) => {
    if (event.target !== $("plots") || event.ctrlKey || event.altKey || event.metaKey) return;
    const action = KEYS[event.key];
    if (!action) return;
    event.preventDefault();
    ACTIONS[action]();
  });
  setInterval(tick, 120);
}
