// Rows of a stretch of time: fetched with points that fit the screen, and carried on by live rows.

export const COLUMNS = ["temperature_degC", "setpoint_degC", "current_A", "resistance_ohm", "target_ohm"];
const KINDS = ["mean", "low", "high"];

export class Series {
  constructor() {
    this.clear();
  }

  clear() {
    this.time_s = [];
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, { mean: [], low: [], high: [] }]));
    this.bucket_s = 0;
    this.step_s = 0;
    this.slot = null;
    this.counts = {};
  }

  /** Take over an answer of /api/history; live rows then fill steps of `step_s`. */
  take(answer, step_s) {
    const kept = this.after(answer.time_s?.at(-1) ?? Infinity);
    this.clear();
    this.time_s = [...(answer.time_s ?? [])];
    for (const name of COLUMNS) {
      const one = answer.columns?.[name];
      const empty = () => new Array(this.time_s.length).fill(null);
      const mean = one?.mean ? [...one.mean] : empty();
      this.columns[name] = { mean, low: [...(one?.low ?? mean)], high: [...(one?.high ?? mean)] };
    }
    this.bucket_s = answer.bucket_s ?? 0;
    this.step_s = Math.max(this.bucket_s, step_s);
    this.join(kept);
  }

  /** Points later than a time: rows that arrived while the answer was on its way. */
  after(time_s) {
    const first = this.time_s.findIndex((one) => one > time_s);
    if (first < 0) return null;
    const columns = Object.fromEntries(COLUMNS.map((name) => [name,
      Object.fromEntries(KINDS.map((kind) => [kind, this.columns[name][kind].slice(first)]))]));
    return { time_s: this.time_s.slice(first), columns };
  }

  join(kept) {
    if (kept === null) return;
    this.time_s.push(...kept.time_s);
    for (const name of COLUMNS) for (const kind of KINDS) this.columns[name][kind].push(...kept.columns[name][kind]);
  }

  /** One live row: into the last step, or a new one. */
  add(row) {
    const time_s = row.time_s;
    if (!Number.isFinite(time_s) || time_s <= (this.time_s.at(-1) ?? -Infinity)) return;
    const slot = this.step_s > 0 ? Math.floor(time_s / this.step_s) : time_s;
    const fresh = slot !== this.slot;
    if (fresh) {
      this.slot = slot;
      this.counts = {};
      this.time_s.push(time_s);
    }
    const last = this.time_s.length - 1;
    for (const name of COLUMNS) {
      const { mean, low, high } = this.columns[name];
      const value = typeof row[name] === "number" ? row[name] : null;
      if (fresh) {
        mean.push(value);
        low.push(value);
        high.push(value);
        if (value !== null) this.counts[name] = 1;
      } else if (value !== null) {
        const n = (this.counts[name] = (this.counts[name] ?? 0) + 1);
        mean[last] = n === 1 ? value : mean[last] + (value - mean[last]) / n;
        low[last] = n === 1 ? value : Math.min(low[last], value);
        high[last] = n === 1 ? value : Math.max(high[last], value);
      }
    }
    if (!fresh && this.step_s < 2) this.time_s[last] = time_s; // a line that reaches "now"
  }

  /** Forget what is older than a time. */
  trim(time_s) {
    const count = this.time_s.findIndex((one) => one >= time_s);
    if (count < 500) return;
    this.time_s.splice(0, count);
    for (const name of COLUMNS) for (const kind of KINDS) this.columns[name][kind].splice(0, count);
  }

  /** [time, wanted, high, low, mean] for a plot: a gap where rows are missing, logarithms' zeros left out. */
  table(name, wanted = null, positive = false) {
    const { mean, low, high } = this.columns[name];
    const want = wanted === null ? null : this.columns[wanted].mean;
    const usual = this.usualStep();
    const out = [[], [], [], [], []];
    const clean = (value) => (value === null || (positive && !(value > 0)) ? null : value);
    for (let k = 0; k < this.time_s.length; k += 1) {
      if (k > 0 && this.time_s[k] - this.time_s[k - 1] > usual) {
        out[0].push((this.time_s[k] + this.time_s[k - 1]) / 2);
        for (let j = 1; j < 5; j += 1) out[j].push(null);
      }
      out[0].push(this.time_s[k]);
      [want === null ? null : want[k], high[k], low[k], mean[k]].forEach((value, j) => out[j + 1].push(clean(value)));
    }
    return out;
  }

  /** The longest distance of rows that is no gap. */
  usualStep() {
    const count = this.time_s.length;
    if (count < 3) return Infinity;
    const steps = [];
    const every = Math.max(1, Math.floor(count / 200));
    for (let k = 1; k < count; k += every) steps.push(this.time_s[k] - this.time_s[k - 1]);
    steps.sort((a, b) => a - b);
    return Math.max(3 * steps[Math.floor(steps.length / 2)], 2.5 * this.step_s, 5);
  }
}
