// The hand on the simulated joystick: its targets, streamed to the daemon. Mouse, touch, pen, keyboard and gamepad give the
// aim; this module moves the hand there.
//
// Targets are sent at the rate of the pointer, at most 250 a second. While the hand is held still they are repeated every
// 10 ms: so this page keeps the stream, and the servo moves between targets in short, even steps. After the hand is released
// no targets are sent; it stays at the last one (docs/protocol.md, Streams).
//
// Targets are sent only between `allow(true)` and `allow(false)`: only the page that controls the forces moves the hand. A
// motion that was requested before begins as soon as it is allowed, if the hand is still held then.

const MIN_TARGET_INTERVAL_MS = 4; // shortest time between two targets
const REPEAT_INTERVAL_MS = 10; // interval of targets while the hand is held still
const REACH_M_PER_S = 0.5; // speed from the hand's position to a new aim
const MAX_STEP_TIME_S = 0.02;
const ARRIVED_WITHIN_M = 1e-5;

// Returns the point from `from` towards `to`, at most `step` away.
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

// Events: `moved`, the target changed; `held`, the hand was taken or released.
export class Hand extends EventTarget {
  limits = null; // [left, bottom, right, top]: the workspace
  target = null; // the target that was sent last; null: this page never moved the hand
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

  // Called if another client moved the hand: the next target begins at the handle.
  forget() {
    if (!this.held) {
      this.target = null;
      this.#aim = null;
      this.dispatchEvent(new Event("moved"));
    }
  }

  // `who` takes the hand to move it to `aim`. It begins at `from`, the handle, if this page has not moved it before.
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
      this.#aim = this.target; // a hand that was moving stays where it is
      this.dispatchEvent(new Event("held"));
    }
  }

  // Releases the hand; a step of the keyboard ends where it is.
  releaseAll() {
    for (const who of [...this.#holders]) {
      this.release(who);
    }
    this.#aim = this.target;
  }

  // Sets the aim of the hand that `who` holds. The hand first moves there at a limited speed, then follows the aim at once.
  aimAt(who, point) {
    if (this.#holders.has(who)) {
      this.#aim = clamped(point, this.limits);
      this.#pump();
    }
  }

  // Moves the hand by `delta` at a limited speed: a step of the keyboard, which does not hold the hand.
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
    if (now - this.#sentAt < MIN_TARGET_INTERVAL_MS) {
      this.#again(MIN_TARGET_INTERVAL_MS);
      return;
    }
    const before = this.target;
    const dt = Math.min(MAX_STEP_TIME_S, (now - this.#pumpedAt) / 1000);
    // A hand that follows its aim reaches it at once, also if no time has passed.
    const step = this.#speed === Infinity ? Infinity : this.#speed * dt;
    this.target = towards(this.target, this.#aim, step);
    this.#pumpedAt = now;
    const there = Math.hypot(this.#aim[0] - this.target[0], this.#aim[1] - this.target[1]) < ARRIVED_WITHIN_M;
    if (there && this.held) {
      this.#speed = Infinity; // the aim is reached: from now on the hand follows the pointer
    }
    const moved = before[0] !== this.target[0] || before[1] !== this.target[1];
    if (moved || (this.held && now - this.#sentAt >= REPEAT_INTERVAL_MS - 1)) {
      this.#sentAt = now;
      this.#send({ seq: ++this.#seq, position_m: this.target });
    }
    if (moved) {
      this.dispatchEvent(new Event("moved"));
    }
    if (!there || this.held) {
      this.#again(there ? REPEAT_INTERVAL_MS : MIN_TARGET_INTERVAL_MS);
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
