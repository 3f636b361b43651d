// The page of the bench: joins the live stream to what is shown.

import { ask, inWords, setStopPort } from "./api.js";
import { latestState, setUpGlance, showLink, showReading, showState } from "./glance.js";
import { historyRow, refetch, setClock, setUpHistory } from "./history.js";
import { refreshJobs, setUpJobs } from "./jobs.js";
import { loopRow, refreshLoop } from "./loop.js";
import { describeStart, refreshConfigurations, setUpStart } from "./start.js";
import { setUpStop } from "./stop.js";
import { Stream } from "./stream.js";
import { setUpToken } from "./token.js";

let linked = false;

function everything() {
  refetch();
  refreshLoop();
  refreshJobs();
  refreshConfigurations();
}

async function readState() {
  const before = latestState();
  try {
    const state = await ask("GET", "/api/state");
    if (latestState() === before) take("state", state); // else the stream has told since, and this may be older
  } catch {
    // the stream tells
  }
}

const TAKES = {
  state: (state) => {
    const before = latestState();
    setClock(state.time_s);
    setStopPort(state.stop_port);
    showState(state);
    describeStart();
    const changed = before?.state !== state.state || before?.queue !== state.queue || before?.job?.id !== state.job?.id;
    if (changed) refreshJobs();
  },
  row: (row) => {
    showReading(row);
    historyRow(row);
    loopRow(row);
  },
  trip: () => readState(),
  job: () => refreshJobs(),
};

function take(kind, content) {
  TAKES[kind](content);
}

function link(word) {
  const now = word === "live";
  showLink(word);
  if (now && !linked) everything();
  linked = now;
}

async function reset(reason) {
  try {
    await ask("POST", "/api/reset", { reason });
    await readState();
    return null;
  } catch (fault) {
    return `Not reset: ${inWords(fault)}.`;
  }
}

setUpStop(readState);
setUpToken();
setUpGlance(reset);
setUpHistory();
setUpJobs();
setUpStart();
new Stream(take, link).open();
