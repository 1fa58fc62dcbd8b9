// Changes of objects that are sent to the daemon: at most one call is under way; later changes are merged into the next. The
// picture shows them at once; a change that the daemon refuses is undone.

// Events: `changed`, when the picture changed; `refused`, {message}.
export class Updates extends EventTarget {
  #call; // (objects) => a promise of {revision}
  #waiting = {};
  #shown = new Map(); // id: {patch, revision}; revision null: not answered yet
  #underWay = null;

  constructor(call) {
    super();
    this.#call = call;
  }

  // Changes an object by a merge patch; null removes it. Resolves when the daemon has accepted or refused it.
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

  // Called when the scene of this revision was read: changes that it contains are no longer shown over it.
  arrived(revision) {
    for (const [id, { revision: known }] of this.#shown) {
      if (known !== null && known <= revision) {
        this.#shown.delete(id);
      }
    }
  }

  // Returns the objects with the changes under way.
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
