// Mouse, fingers and keys on the picture: drag pans, the wheel and two fingers zoom.

const KEY_ACTIONS = {
  ArrowLeft: (actions, shift) => actions.pan(shift ? -0.5 : -0.05),
  ArrowRight: (actions, shift) => actions.pan(shift ? 0.5 : 0.05),
  PageUp: (actions) => actions.pan(-0.9),
  PageDown: (actions) => actions.pan(0.9),
  "+": (actions) => actions.step(-1),
  "=": (actions) => actions.step(-1),
  "-": (actions) => actions.step(1),
  h: (actions) => actions.toggleHold(),
  H: (actions) => actions.toggleHold(),
};

export function shortcuts(stage, actions) {
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) {
      return;
    }
    if (event.key === "Home" && event.target === stage) {
      event.preventDefault();
      actions.run();
    }
    const act = KEY_ACTIONS[event.key];
    if (act !== undefined) {
      event.preventDefault();
      act(actions, event.shiftKey);
    }
  });
}

export function pointerGestures(stage, plot, view, actions) {
  const pointers = new Map(); // pressed pointers: clientX by id
  const share = (clientX) => {
    const { left, width } = plot.cssBox;
    return Math.min(1, Math.max(0, (clientX - stage.getBoundingClientRect().left - left) / width));
  };

  stage.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
        actions.pan(event.deltaX / plot.cssBox.width);
      } else {
        actions.zoom(2 ** (event.deltaY / 300), share(event.clientX));
      }
    },
    { passive: false },
  );
  stage.addEventListener("pointerdown", (event) => {
    if (event.button === 0) {
      pointers.set(event.pointerId, event.clientX);
      stage.setPointerCapture(event.pointerId);
    }
  });
  stage.addEventListener("pointermove", (event) => {
    if (!pointers.has(event.pointerId)) {
      return;
    }
    const before = [...pointers.values()];
    pointers.set(event.pointerId, event.clientX);
    const after = [...pointers.values()];
    if (after.length === 1) {
      if (after[0] !== before[0]) {
        actions.pan((before[0] - after[0]) / plot.cssBox.width);
      }
    } else {
      const wide = (xs) => Math.max(10, Math.abs(xs[0] - xs[1]));
      actions.zoom(wide(before) / wide(after), share((after[0] + after[1]) / 2));
    }
  });
  const up = (event) => pointers.delete(event.pointerId);
  stage.addEventListener("pointerup", up);
  stage.addEventListener("pointercancel", up);
}
