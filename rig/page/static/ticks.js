// Where ticks of an axis go: round numbers, on a line and on a scale of decades.

/** Round numbers from low to high, about `count` of them. */
export function linear(low, high, count = 5) {
  const rough = (high - low) / Math.max(1, count);
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((one) => one * power).find((one) => one >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k += 1) {
    ticks.push(Number((k * step).toPrecision(12)));
  }
  return ticks;
}

/** Decades, then 1-2-5, then round numbers: whatever gives enough ticks between low and high. */
export function decades(low, high, count = 4) {
  const found = (digits) => {
    const ticks = [];
    for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power += 1) {
      for (const digit of digits) {
        const value = Number((digit * 10 ** power).toPrecision(6));
        if (value >= low && value <= high) ticks.push(value);
      }
    }
    return ticks;
  };
  for (const digits of [[1], [1, 3], [1, 2, 5]]) {
    const ticks = found(digits);
    if (ticks.length >= Math.min(3, count)) return ticks;
  }
  return linear(low, high, count);
}

const DAY_S = 86400;
const STEPS_S = [1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 10800, 21600, 43200,
  ...[1, 2, 4, 7, 14, 28, 56, 91, 182, 364].map((days) => days * DAY_S)];

/** [times, step]: round local times, at most `count` of them. */
export function times(low_s, high_s, count) {
  const step_s = STEPS_S.find((one) => (high_s - low_s) / one <= count) ?? 728 * DAY_S;
  const zone_s = -60 * new Date(((low_s + high_s) / 2) * 1000).getTimezoneOffset();
  const ticks = [];
  for (let k = Math.ceil((low_s + zone_s) / step_s); k * step_s - zone_s <= high_s; k += 1) {
    ticks.push(k * step_s - zone_s);
  }
  return [ticks, step_s];
}

/** Limits of a decade axis around values: some air, and never narrower than a tenth of a decade. */
export function decadeLimits(low, high) {
  if (!(low > 0) || !(high > 0)) return [1e3, 1e5];
  const middle = Math.log10(low * high) / 2;
  const half = Math.max(Math.log10(high / low) * 0.56, 0.05);
  return [10 ** (middle - half), 10 ** (middle + half)];
}

/** Limits of a linear axis around values: some air, and never narrower than `least`. */
export function linearLimits(low, high, least) {
  const middle = (low + high) / 2;
  const half = Math.max((high - low) * 0.56, least / 2);
  return [middle - half, middle + half];
}
