// The hand on the simulated joystick: where it wants to be, streamed to the daemon as targets. Mouse, touch, pen,
// keyboard and gamepad say where it should go; this file says how it gets there.
//
// Targets leave at the rate of the pointer, 250 a second at most. While the hand is held still they are repeated every
// 10 ms: so the stream stays ours, and the servo goes on from target to target in short, even steps. Once it is let go no
// more come; the hand stays where the last one was (docs/protocol.md, Streams).
//
// Nothing leaves before `allow(true)`, nor after `allow(false)`: only the page that holds the forces moves the hand. What was
// called for meanwhile is begun as soon as it is allowed, if it is still held then.

const LEAST_MS = 4; // between two targets
const REPEAT_MS = 10; // of a hand that is held still
const REACH_M_PER_S = 0.5; // from where the hand is to where it was called
const MOST_DT_S = 0.02;
const THERE_M = 1e-5;

// From `from` towards `to`, by at most `step`.
export function towards(from, to, step) {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]];
  const distance = Math.hypot(dx, dy);
  if (distance <= step) {
    return to;
  }
  return [from[0] + (dx / distance) * step, from[1] + (dy / distance) * step];
}

export function clamped(point, limits) {
  if (limits === null) {
    return point;
  }
  const [left, bottom, right, top] = limits;
  return [Math.min(right, Math.max(left, point[0])), Math.min(top, Math.max(bottom, point[1]))];
}

// Events: `moved`, the target is another one; `held`, it was taken or let go.
export class Hand extends EventTarget {
  limits = null; // [left, bottom, right, top]: the workspace
  target = null; // where the hand is, as it was sent last; null: this page never moved it
  #aim = null;
  #speed = REACH_M_PER_S;
  #allowed = false;
  #holders = new Set();
  #seq = 0;
  #sentAt = -Infinity;
  #pumpedAt = 0;
  #timer = null;
  #send;
  #now;

  // `send(message)` streams {seq, position_m}; `now()` is in ms.
  constructor(send, now = () => performance.now()) {
    super();
    this.#send = send;
    this.#now = now;
  }

  get held() {
    return this.#holders.size > 0;
  }

  allow(allowed) {
    if (allowed === this.#allowed) {
      return;
    }
    this.#allowed = allowed;
    if (!allowed) {
      this.releaseAll();
    } else if (this.target !== null) {
      this.#pumpedAt = this.#now();
      this.#pump();
    }
  }

  // Somebody else moved the hand: the next target begins at the handle again.
  forget() {
    if (!this.held) {
      this.target = null;
      this.#aim = null;
      this.dispatchEvent(new Event("moved"));
    }
  }

  // `who` takes the hand, to move it to `aim`. It begins at `from`, the handle, where this page has not moved it before.
  take(who, from, aim = null) {
    this.target ??= from;
    this.#aim = clamped(aim ?? this.target, this.limits);
    this.#holders.add(who);
    this.#speed = REACH_M_PER_S;
    this.#pumpedAt = this.#now();
    this.dispatchEvent(new Event("held"));
    this.#pump();
  }

  release(who) {
    if (this.#holders.delete(who)) {
      this.#aim = this.target; // a hand that was on its way stays where it got
      this.dispatchEvent(new Event("held"));
    }
  }

  // Nobody holds it any more, and a step of the keyboard goes no further.
  releaseAll() {
    for (const who of [...this.#holders]) {
      this.release(who);
    }
    this.#aim = this.target;
  }

  // Where the hand should go, of one that holds it. Once it got there it follows at once; before that it reaches out at a
  // hand's speed.
  aimAt(who, point) {
    if (this.#holders.has(who)) {
      this.#aim = clamped(point, this.limits);
      this.#pump();
    }
  }

  // By so much, at most so fast: a step of the keyboard, which nobody holds.
  step(delta, from, speed) {
    this.target ??= from;
    this.#aim ??= this.target;
    this.#aim = clamped([this.#aim[0] + delta[0], this.#aim[1] + delta[1]], this.limits);
    if (this.#timer === null) {
      this.#pumpedAt = this.#now();
    }
    this.#speed = speed;
    this.#pump();
  }

  #pump() {
    if (!this.#allowed) {
      return;
    }
    const now = this.#now();
    if (now - this.#sentAt < LEAST_MS) {
      this.#again(LEAST_MS);
      return;
    }
    const before = this.target;
    const dt = Math.min(MOST_DT_S, (now - this.#pumpedAt) / 1000);
    // A hand that has caught up is there at once, in no time, too.
    const step = this.#speed === Infinity ? Infinity : this.#speed * dt;
    this.target = towards(this.target, this.#aim, step);
    this.#pumpedAt = now;
    const there = Math.hypot(this.#aim[0] - this.target[0], this.#aim[1] - this.target[1]) < THERE_M;
    if (there && this.held) {
      this.#speed = Infinity; // caught up: from now on it is where the pointer is
    }
    const moved = before[0] !== this.target[0] || before[1] !== this.target[1];
    if (moved || (this.held && now - this.#sentAt >= REPEAT_MS - 1)) {
      this.#sentAt = now;
      this.#send({ seq: ++this.#seq, position_m: this.target });
    }
    if (moved) {
      this.dispatchEvent(new Event("moved"));
    }
    if (!there || this.held) {
      this.#again(there ? REPEAT_MS : LEAST_MS);
    }
  }

  #again(ms) {
    if (this.#timer === null) {
      this.#timer = setTimeout(() => {
        this.#timer = null;
        if (this.target !== null) {
          this.#pump();
        }
      }, ms);
    }
  }
}
