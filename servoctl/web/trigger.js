// A trigger on a sampled signal.

/// Time of the first crossing of `level` after `since`: between two samples, by a straight line; null if there is none.
export function crossing(times, values, level, rising, since) {
  for (let i = 1; i < times.length; i++) {
    if (times[i] <= since) continue;
    const [before, after] = rising ? [values[i - 1], values[i]] : [-values[i - 1], -values[i]];
    const at = rising ? level : -level;
    if (before < at && after >= at) {
      return times[i - 1] + ((at - before) / (after - before)) * (times[i] - times[i - 1]);
    }
  }
  return null;
}

/// Share of the view that lies before the trigger.
const BEFORE = 0.2;

/// What the view shows: the newest `span` seconds, or what was around the last crossing.
export class Trigger {
  mode = "off";
  once = false;
  level = 0;
  #fired = null;
  #armed = -Infinity;

  /// Waits for a crossing after `now`.
  arm(now) {
    this.#fired = null;
    this.#armed = now;
  }

  /// Beginning and end of the view, and what the trigger does.
  view(times, values, span) {
    const now = times.length ? times[times.length - 1] : 0;
    if (this.mode === "off") return { from: now - span, to: now, state: "" };
    const complete = this.#fired === null || now >= this.#fired + (1 - BEFORE) * span;
    if (complete && !(this.once && this.#fired !== null)) {
      const since = this.#fired === null ? this.#armed : this.#fired + (1 - BEFORE) * span;
      const at = crossing(times, values, this.level, this.mode === "rising", since);
      if (at !== null) this.#fired = at;
    }
    if (this.#fired === null) return { from: now - span, to: now, state: "waiting" };
    const from = this.#fired - BEFORE * span;
    const state = now < from + span ? "triggered" : this.once ? "triggered, held" : "triggered, waiting for the next";
    return { from, to: from + span, state };
  }

  /// The moment of the last crossing, or null.
  get fired() {
    return this.#fired;
  }
}
