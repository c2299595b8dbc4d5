// The edits of a structure, one after the other, with undo and redo; the study file is what they change.
import {post} from "./api.js";
import {applied, readStructure} from "./study_structure.js";

const histories = new Map(); // of every study that this page edited: what can be undone and done again

export class Editor {
  constructor(app, drawn) {
    this.app = app;
    this.drawn = drawn;
    this.study = app.study;
    this.table = app.now.table;
    this.waiting = Promise.resolve();
    this.count = 0;
    if (!histories.has(app.study)) {
      histories.set(app.study, {undo: [], redo: [], text: app.now.text});
    }
    this.history = histories.get(app.study);
    if (this.history.text !== app.now.text) {
      Object.assign(this.history, {undo: [], redo: [], text: app.now.text});
    } // another changed it: undoing would undo that
    this.read();
  }

  read() {
    this.model = readStructure(this.table);
  }

  // Do `action(model)`, which gives {words, edits} or refuses at once; the answer comes when it is written.
  do(action) {
    const {words, edits} = action(this.model);
    if (!edits.length) {
      return Promise.resolve();
    }
    this.table = applied(this.table, edits); // what follows builds on it before it is written
    this.read();
    const written = this.queued(async () => {
      const before = this.app.now.text;
      await this.app.edit(edits);
      if (this.app.now.text !== before) {
        this.history.undo.push({text: before, words});
        this.history.redo.length = 0;
      }
    });
    this.drawn();
    return written;
  }

  async queued(job) {
    this.count += 1;
    const mine = this.waiting.then(job);
    this.waiting = mine.catch(() => {});
    try {
      await mine;
    } finally {
      this.count -= 1;
      this.history.text = this.app.now.text;
      if (!this.count) {
        this.table = this.app.now.table;
        this.read();
        this.drawn();
      }
    }
  }

  undo() {
    return this.back(this.history.undo, this.history.redo, "Undone");
  }
  redo() {
    return this.back(this.history.redo, this.history.undo, "Done again");
  }

  back(from, to, told) {
    return this.queued(async () => {
      const last = from.at(-1);
      if (!last) {
        return;
      }
      const before = this.app.now.text;
      this.app.now = await this.app.answer(
        post("study", {study: this.study, text: last.text, digest: this.app.now.digest}),
      );
      from.pop();
      to.push({text: before, words: last.words});
      this.app.say(`${told}: ${last.words}`);
    });
  }
}
