// Mouse, touch and pen on the canvas. One finger or the left button moves the hand or arranges; two fingers, the middle
// button, or Shift in Feel mode move and zoom the view.

const HAS_RAW_UPDATES = "onpointerrawupdate" in window; // gives all reports of the mouse, not only one a frame

export class Pointers {
  #canvas;
  #view;
  #down = new Map(); // pointer id: its last position
  #use = null; // "hand", "arrange", "pan" or "pinch"
  #pinch = null;

  // `view`: {mode, transform, hand, arrange, canFeel, takeHand(px), viewed(), touched()}
  constructor(canvas, view) {
    this.#canvas = canvas;
    this.#view = view;
    const on = (name, call) => canvas.addEventListener(name, call.bind(this));
    on("pointerdown", this.#pressed);
    on(HAS_RAW_UPDATES ? "pointerrawupdate" : "pointermove", this.#moved);
    if (HAS_RAW_UPDATES) {
      on("pointermove", this.#moved); // synthetic pointers have no raw updates
    }
    on("pointerup", this.#lifted);
    on("pointercancel", this.#cancelled);
    on("lostpointercapture", this.#cancelled);
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    on("contextmenu", (event) => event.preventDefault());
    document.addEventListener("visibilitychange", () => document.hidden && this.#stop());
  }

  #place(event) {
    const box = this.#canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  #pressed(event) {
    if (event.button === 2) {
      return;
    }
    event.preventDefault();
    this.#canvas.focus({ preventScroll: true });
    this.#canvas.setPointerCapture(event.pointerId);
    const px = this.#place(event);
    this.#down.set(event.pointerId, px);
    if (this.#down.size === 2) {
      this.#stop();
      this.#use = "pinch";
      this.#pinch = this.#fingers();
      return;
    }
    if (this.#down.size > 2) {
      return;
    }
    const { mode, canFeel } = this.#view;
    if (event.button === 1 || (mode === "feel" && event.shiftKey)) {
      this.#use = "pan";
    } else if (mode === "arrange") {
      this.#use = this.#view.arrange.begin(px) ? "arrange" : "pan";
    } else if (canFeel) {
      this.#use = "hand";
      this.#view.takeHand(px);
    } else {
      this.#use = "pan";
    }
    this.#view.touched(this.#use);
  }

  #moved(event) {
    const before = this.#down.get(event.pointerId);
    const px = this.#place(event);
    if (before === undefined) {
      if (this.#view.mode === "arrange" && event.type === "pointermove") {
        this.#view.hover(px);
      }
      return;
    }
    if (px[0] === before[0] && px[1] === before[1]) {
      return;
    }
    this.#down.set(event.pointerId, px);
    const { transform, hand, arrange } = this.#view;
    if (this.#use === "hand") {
      hand.aimAt("pointer", transform.toM(px));
    } else if (this.#use === "arrange") {
      arrange.drag(px, event.shiftKey);
    } else if (this.#use === "pan") {
      transform.pan(px[0] - before[0], px[1] - before[1]);
      this.#view.viewed();
    } else if (this.#use === "pinch" && this.#down.size >= 2) {
      const now = this.#fingers();
      transform.pan(now.middle[0] - this.#pinch.middle[0], now.middle[1] - this.#pinch.middle[1]);
      transform.zoom(now.apart / this.#pinch.apart, now.middle);
      this.#pinch = now;
      this.#view.viewed();
    }
  }

  #fingers() {
    const [a, b] = [...this.#down.values()];
    return {
      middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2],
      apart: Math.max(10, Math.hypot(a[0] - b[0], a[1] - b[1])),
    };
  }

  #lifted(event) {
    if (!this.#down.delete(event.pointerId)) {
      return;
    }
    if (this.#use === "hand") {
      this.#view.hand.release("pointer");
    } else if (this.#use === "arrange") {
      this.#view.arrange.end();
    }
    // After a pinch the remaining finger does nothing until it is lifted.
    this.#use = this.#use === "pinch" && this.#down.size > 0 ? "rest" : null;
    this.#view.touched(this.#use);
  }

  #cancelled(event) {
    if (this.#down.delete(event.pointerId)) {
      this.#stop();
    }
  }

  // Ends every press and drag.
  #stop() {
    this.#view.hand.release("pointer");
    this.#view.arrange.cancel();
    this.#use = null;
    this.#view.touched(null);
  }

  #wheel(event) {
    event.preventDefault();
    const { transform } = this.#view;
    if (event.shiftKey && !event.ctrlKey) {
      transform.pan(-(event.deltaX || event.deltaY), 0);
    } else {
      const lines = event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 400 : 1;
      // A pinch on a touchpad comes as a wheel with ctrl, in small steps.
      transform.zoom(Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0015)), this.#place(event));
    }
    this.#view.viewed();
  }
}
