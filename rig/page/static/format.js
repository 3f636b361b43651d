// Numbers and times as a person at the bench reads them. Null is "not known": an en dash.

const known = (value) => typeof value === "number" && Number.isFinite(value);
const two = (value) => String(value).padStart(2, "0");
const minus = (text) => text.replace("-", "−");
const MONTHS = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

export const degrees = (value) => (known(value) ? minus(value.toFixed(2)) : "–");

export function amperes(value) {
  if (!known(value)) return "–";
  const text = value.toFixed(3);
  return Number(text) === 0 ? "0.000" : minus(value > 0 ? `+${text}` : text);
}

/** Share of full drive, three decimals: a heater never cools, so there is no sign. */
export const share = (value) => (known(value) ? minus(value.toFixed(3).replace(/^-(0\.0+)$/, "$1")) : "–");

/** [number, unit] of a resistance, four figures. */
export function ohms(value) {
  if (!known(value)) return ["–", "Ω"];
  const size = Math.abs(value);
  const [scale, unit] = size >= 999500 ? [1e6, "MΩ"] : size >= 999.5 ? [1e3, "kΩ"] : [1, "Ω"];
  return [minus((value / scale).toPrecision(4)), unit];
}

/** A resistance in one string, three figures, for ticks and sentences. */
export function ohmsShort(value) {
  if (!known(value)) return "–";
  const size = Math.abs(value);
  const [scale, unit] = size >= 999500 ? [1e6, "M"] : size >= 999.5 ? [1e3, "k"] : [1, ""];
  return `${minus(String(Number((value / scale).toPrecision(3))))} ${unit}Ω`;
}

export function duration(seconds) {
  if (!known(seconds)) return "–";
  if (seconds < 10) return `${Math.max(0, seconds).toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ${two(Math.floor(seconds % 60))} s`;
  if (seconds < 172800) return `${Math.floor(seconds / 3600)} h ${two(Math.floor((seconds % 3600) / 60))} min`;
  return `${Math.floor(seconds / 86400)} d ${Math.floor((seconds % 86400) / 3600)} h`;
}

export const timeOfDay = (time_s, seconds = true) => {
  const at = new Date(time_s * 1000);
  return `${two(at.getHours())}:${two(at.getMinutes())}${seconds ? `:${two(at.getSeconds())}` : ""}`;
};

export const day = (time_s) => {
  const at = new Date(time_s * 1000);
  return `${at.getDate()} ${MONTHS[at.getMonth()]}`;
};

/** Time of day; with the date where it is not today. */
export function when(time_s) {
  if (!known(time_s)) return "–";
  const same = new Date(time_s * 1000).toDateString() === new Date().toDateString();
  return same ? timeOfDay(time_s) : `${day(time_s)} ${timeOfDay(time_s, false)}`;
}
