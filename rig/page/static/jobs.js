// Runs: what is queued, what runs, what ran and why it ended, with links to reports.

import { ask, inWords } from "./api.js";
import { $, icon, make, say, sayOrHide } from "./dom.js";
import { duration, when } from "./format.js";

const FEW = 8;
const ORDER = { running: 0, queued: 1 };
const NEEDS = { running: "End", queued: "Remove" };
let shown = "";
let all = false;
let jobs = [];
let timer = null;

/** A report's address, where it stays on this bench. */
const address = (report) => (typeof report === "string" && /^\/[^/\\]/.test(report) ? report : null);

function sorted(list) {
  const rank = (job) => ORDER[job.state] ?? 2;
  const time = (job) => job.started_s ?? job.queued_s ?? 0;
  return [...list].sort((a, b) => rank(a) - rank(b) || (rank(a) === 1 ? time(a) - time(b) : time(b) - time(a)));
}

function last(job) {
  const verb = NEEDS[job.state];
  if (verb) {
    const label = job.state === "running" ? `End the run ${job.name}` : `Take ${job.name} out of the queue`;
    const button = make("button", { type: "button", "aria-label": label, id: `job-${job.id}` }, verb);
    button.addEventListener("click", () => take(job, button));
    return button;
  }
  const where = address(job.report);
  return where ? make("a", { href: where, target: "_blank", rel: "noopener" }, "report",
    make("span", { class: "unseen" }, ` of ${job.name}`)) : "";
}

function row(job) {
  const state = String(job.state);
  const begun = job.started_s ?? job.queued_s;
  const took = job.started_s && job.ended_s ? duration(job.ended_s - job.started_s) : "";
  return make("tr", {},
    make("td", { class: "state" }, make("span", { class: "job", "data-state": state }, icon(state), state)),
    make("td", { class: "run" }, make("b", {}, String(job.name)), ` ${String(job.kind ?? "").replaceAll("_", " ")}`),
    make("td", { class: "when" }, when(begun)),
    make("td", { class: "took" }, took),
    make("td", { class: "why" }, job.reason ? String(job.reason) : ""),
    make("td", {}, last(job)));
}

function render() {
  const list = sorted(jobs);
  const part = all ? list : list.slice(0, FEW);
  const key = JSON.stringify(part) + all;
  if (key === shown) return;
  shown = key;
  const focused = document.activeElement?.id;
  $("jobs").tBodies[0].replaceChildren(...part.map(row));
  if (focused?.startsWith("job-")) $(focused)?.focus();
  $("jobs").hidden = list.length === 0;
  $("jobs-none").hidden = list.length > 0;
  $("jobs-more").hidden = list.length <= FEW;
  say($("jobs-more"), all ? "Show fewer" : `Show all ${list.length}`);
  const queued = list.filter((job) => job.state === "queued").length;
  say($("queue-line"), queued ? `${queued} in the queue` : "");
}

async function take(job, button) {
  button.disabled = true;
  try {
    await ask("DELETE", `/api/jobs/${encodeURIComponent(job.id)}`);
    sayOrHide($("jobs-said"), null);
  } catch (fault) {
    button.disabled = false;
    sayOrHide($("jobs-said"), `${job.name}: ${inWords(fault)}.`);
  }
  refreshJobs();
}

/** Ask for the list soon; many events in a row make one request. */
export function refreshJobs() {
  clearTimeout(timer);
  timer = setTimeout(async () => {
    try {
      const answer = await ask("GET", "/api/jobs");
      jobs = Array.isArray(answer) ? answer : answer?.jobs ?? [];
      render();
    } catch {
      // the stream tells that the bench is away; the list is asked for again when it is back
    }
  }, 150);
}

export function setUpJobs() {
  $("jobs-more").addEventListener("click", () => {
    all = !all;
    render();
  });
}
