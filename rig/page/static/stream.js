// The live stream of the bench: opened, watched, opened again after ever longer pauses, closed while nobody looks.
// A browser keeps six connections to one server: a hidden tab that held one could keep another tab's STOP waiting.

import { ask, makeSession, Refused } from "./api.js";

const KINDS = ["state", "row", "trip", "job"];
const SILENCE_S = 12; // the bench says its state at least every 5 s
const PAUSES_S = [0.3, 0.6, 1.2, 2.5, 5, 8];
const HIDDEN_S = 5;
const HIDDEN_POLL_S = 15;

/** Calls take(kind, object) for every event, and link("live" | "lost") at every change of the connection. */
export class Stream {
  constructor(take, link) {
    this.take = take;
    this.link = link;
    this.source = null;
    this.tries = 0;
    this.timer = null;
    this.heard = 0;
    this.generation = 0;
    setInterval(() => this.watch(), 1000);
    document.addEventListener("visibilitychange", () => this.look());
    window.addEventListener("pagehide", () => this.close());
    window.addEventListener("pageshow", (event) => event.persisted && this.open());
    window.addEventListener("online", () => this.open());
    document.addEventListener("token-given", () => this.open());
  }

  /** Ask for the state, then listen. */
  async open() {
    this.close();
    const generation = this.generation;
    try {
      const state = await ask("GET", "/api/state", undefined, { timeout_s: 5 });
      if (generation !== this.generation) return;
      this.arrived("state", state);
      if (document.hidden) return this.again(HIDDEN_POLL_S);
      await makeSession();
      if (generation === this.generation) this.listen();
    } catch (fault) {
      if (generation !== this.generation) return;
      this.link("lost");
      const waitsForToken = fault instanceof Refused && fault.status === 401;
      if (!waitsForToken) this.again();
    }
  }

  listen() {
    const source = new EventSource("/api/events");
    this.source = source;
    for (const kind of KINDS) {
      source.addEventListener(kind, (event) => {
        let content;
        try {
          content = JSON.parse(event.data);
        } catch {
          return;
        }
        this.arrived(kind, content);
      });
    }
    source.onerror = () => {
      if (this.source !== source) return;
      this.close();
      this.link("lost");
      this.again();
    };
  }

  arrived(kind, content) {
    this.heard = performance.now();
    this.tries = 0;
    this.link("live");
    this.take(kind, content);
  }

  /** Try again, later each time; a little at random, so that fifty viewers do not come at once. */
  again(pause_s = PAUSES_S[Math.min(this.tries, PAUSES_S.length - 1)] * (0.8 + 0.4 * Math.random())) {
    this.tries += 1;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.open(), pause_s * 1000);
  }

  close() {
    this.generation += 1;
    clearTimeout(this.timer);
    this.source?.close();
    this.source = null;
  }

  watch() {
    if (this.source === null || performance.now() - this.heard < SILENCE_S * 1000) return;
    this.close();
    this.link("lost");
    this.again();
  }

  look() {
    clearTimeout(this.hiding);
    if (document.hidden) this.hiding = setTimeout(() => this.open(), HIDDEN_S * 1000);
    else if (this.source === null) this.open();
  }
}
