// Starting a run: one of the listed configurations as it is, or its text changed, or a text of one's own.

import { ask, inWords, Refused } from "./api.js";
import { $, make, say } from "./dom.js";
import { latestState } from "./glance.js";

const OWN = "\u0000own";
let listed = [];

const chosen = () => listed.find((one) => one.name === $("configuration").value) ?? null;
const isOwn = () => chosen() === null || $("text").value !== chosen().text;

function describe() {
  const one = chosen();
  const own = isOwn();
  $("own-name").hidden = !own;
  $("start-button").disabled = own && !$("text").value.trim();
  const words = one ? `Your own text, changed from ${one.name}` : "Your own text";
  say($("text-summary"), own ? words : "Show and change its text");
  const state = latestState()?.state;
  say($("start-button"), state === "running" ? "Add to the queue" : "Start the run");
  const limits = latestState()?.limits?.temperature_degC;
  say($("hold-note"), limits ? `between ${limits[0]} and ${limits[1]} °C, the bench's limits` : "");
  say($("start-note"), state === "tripped" || state === "stopped" ? "waits in the queue until the reset" : "");
}

function fill() {
  const one = chosen();
  $("text").value = one ? one.text ?? "" : "";
  $("name").value = one ? `${one.name}, changed` : "";
  if (!one) $("text-fold").open = true;
  faults([]);
  describe();
}

function faults(lines, title = "") {
  $("faults").hidden = lines.length === 0;
  say($("faults").querySelector("h3"), title);
  $("faults").querySelector("ol").replaceChildren(...lines.map((line) => make("li", {}, String(line))));
}

async function submit(event) {
  event.preventDefault();
  const own = isOwn();
  const body = own ? { text: $("text").value, name: $("name").value.trim() || "own" } : { configuration: chosen().name };
  await asked(body, $("start-button"));
  describe();
}

/** Ask for a run, and say what became of that. */
async function asked(body, button) {
  button.disabled = true;
  say($("start-said"), "");
  try {
    const job = await ask("POST", "/api/jobs", body);
    faults([]);
    const where = job?.state === "running" ? "is running" : "was taken into the queue";
    say($("start-said"), `${job?.name ?? "The run"} ${where}.`);
  } catch (fault) {
    const lines = fault instanceof Refused && Array.isArray(fault.body?.faults) ? fault.body.faults : [inWords(fault)];
    faults(lines, lines.length === 1 ? "Not started: one fault" : `Not started: ${lines.length} faults`);
  }
}

const numberIn = (text) => (text.trim() === "" ? NaN : Number(text.trim().replace(",", ".")));

/** A hold by its temperature alone: the bench's own configuration with that as its target. */
async function hold(event) {
  event.preventDefault();
  const [degC, minutes] = [numberIn($("hold-degC").value), numberIn($("hold-minutes").value)];
  const wrong = [Number.isFinite(degC) ? null : "temperature: expected a number, °C",
    Number.isFinite(minutes) ? null : "time: expected a number, min"].filter(Boolean);
  if (wrong.length) return faults(wrong, "Not started");
  await asked({ hold_degC: degC, hold_s: minutes * 60 }, $("hold-button"));
  $("hold-button").disabled = false;
  return describe();
}

/** Ask for the listed configurations; what the user has typed stays. */
export async function refreshConfigurations() {
  let answer;
  try {
    answer = await ask("GET", "/api/configurations");
  } catch {
    return;
  }
  const typed = isOwn() && $("text").value.trim() !== "";
  const before = $("configuration").value;
  listed = Array.isArray(answer) ? answer : answer?.configurations ?? [];
  $("configuration").replaceChildren(
    ...listed.map((one) => make("option", { value: one.name },
      one.kind ? `${one.name} (${String(one.kind).replaceAll("_", " ")})` : one.name)),
    make("option", { value: OWN }, "own text …"));
  if (before) $("configuration").value = before;
  if ($("configuration").selectedIndex < 0) $("configuration").selectedIndex = 0;
  if (typed) describe();
  else fill();
}

export function setUpStart() {
  $("configuration").addEventListener("change", fill);
  $("text").addEventListener("input", describe);
  $("start-form").addEventListener("submit", submit);
  $("hold-form").addEventListener("submit", hold);
}

export const describeStart = describe;
