// Changes of objects on their way to the daemon: at most one call is under way, what comes meanwhile is merged into the
// next. The picture shows them at once; what the daemon refuses falls back to how it was.

// Events: `changed`, the picture is another one; `refused`, {message}.
export class Updates extends EventTarget {
  #call; // (objects) => a promise of {revision}
  #waiting = {};
  #shown = new Map(); // id: {patch, revision}; revision null: not answered yet
  #underWay = null;

  constructor(call) {
    super();
    this.#call = call;
  }

  // An object as a merge patch, null removes it. Resolves when the daemon took it, or refused it.
  send(id, patch) {
    this.#waiting[id] = patch === null ? null : { ...this.#waiting[id], ...patch };
    const before = this.#shown.get(id)?.patch;
    this.#shown.set(id, { patch: patch === null ? null : { ...before, ...patch }, revision: null });
    this.dispatchEvent(new Event("changed"));
    this.#underWay ??= this.#run();
    return this.#underWay;
  }

  async #run() {
    while (Object.keys(this.#waiting).length > 0) {
      const sent = this.#waiting;
      this.#waiting = {};
      try {
        const { revision } = await this.#call(sent);
        this.#answered(sent, revision);
      } catch (error) {
        for (const id of Object.keys(sent)) {
          this.#shown.delete(id);
          delete this.#waiting[id];
        }
        this.dispatchEvent(new CustomEvent("refused", { detail: { message: error.message } }));
        this.dispatchEvent(new Event("changed"));
      }
    }
    this.#underWay = null;
  }

  #answered(sent, revision) {
    for (const id of Object.keys(sent)) {
      if (!(id in this.#waiting) && this.#shown.has(id)) {
        this.#shown.get(id).revision = revision;
      }
    }
  }

  // The scene was read again, at this revision: what it has in it is no longer laid over it.
  arrived(revision) {
    for (const [id, { revision: known }] of this.#shown) {
      if (known !== null && known <= revision) {
        this.#shown.delete(id);
      }
    }
  }

  // The objects as they will be.
  over(objects) {
    if (this.#shown.size === 0) {
      return objects;
    }
    const result = { ...objects };
    for (const [id, { patch }] of this.#shown) {
      if (patch === null) {
        delete result[id];
      } else if (result[id] !== undefined) {
        result[id] = { ...result[id], ...patch };
      }
    }
    return result;
  }
}
