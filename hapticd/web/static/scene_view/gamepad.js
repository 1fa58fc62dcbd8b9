// A gamepad as the hand: its left stick sets the velocity of the hand, not its position. So the hand stays when the stick is
// released, and a coarse stick still reaches every tenth of a millimetre.

export const DEAD_ZONE = 0.15; // fraction of the stick's travel in which the hand rests
const MAX_SPEED_M_PER_S = 0.15; // speed at the end of the stick's travel

// Returns the hand's velocity for a stick at x, y (-1 to 1, y down, as in the browser's API): 0 within the dead zone,
// quadratic beyond it, so that small motions are fine.
export function speedOf(x, y) {
  const size = Math.min(1, Math.hypot(x, y));
  if (size <= DEAD_ZONE) {
    return [0, 0];
  }
  const part = (size - DEAD_ZONE) / (1 - DEAD_ZONE);
  const speed = MAX_SPEED_M_PER_S * part * part;
  const length = Math.hypot(x, y);
  return [(x / length) * speed, (-y / length) * speed];
}

export class GamepadHand {
  #hand;
  #from; // () => where the handle is
  #frame = null;
  #before = 0;

  // `allowed()` returns whether the hand may be moved; `taking()` is called when the stick leaves the dead zone.
  constructor(hand, from, allowed, taking) {
    this.#hand = hand;
    this.#from = from;
    this.allowed = allowed;
    this.taking = taking;
    addEventListener("gamepadconnected", () => this.#watch());
    if (this.#pad() !== null) {
      this.#watch();
    }
  }

  #pad() {
    return [...navigator.getGamepads()].find((pad) => pad !== null && pad.connected) ?? null;
  }

  #watch() {
    if (this.#frame === null) {
      this.#before = performance.now();
      this.#frame = requestAnimationFrame((now) => this.#look(now));
    }
  }

  #look(now) {
    this.#frame = null;
    const pad = this.#pad();
    if (pad === null) {
      this.#rest();
      return;
    }
    const dt = Math.min(0.05, Math.max(0, (now - this.#before) / 1000));
    this.#before = now;
    const [vx, vy] = this.allowed() ? speedOf(pad.axes[0], pad.axes[1]) : [0, 0];
    if (vx !== 0 || vy !== 0) {
      if (!this.#moving) {
        this.#moving = true;
        this.#hand.take("gamepad", this.#from());
        this.taking();
      }
      const at = this.#hand.target;
      if (at !== null) {
        this.#hand.aimAt("gamepad", [at[0] + vx * dt, at[1] + vy * dt]);
      }
    } else {
      this.#rest();
    }
    this.#frame = requestAnimationFrame((next) => this.#look(next));
  }

  #moving = false; // the stick is beyond the dead zone

  #rest() {
    if (this.#moving) {
      this.#moving = false;
      this.#hand.release("gamepad");
    }
  }
}
