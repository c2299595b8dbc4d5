// Tables of cells that are typed into: by keyboard alone, with what is wrong told beneath its cell.
import {h} from "./dom.js";
import {forgetTyped, refuseTyped} from "./typed.js";

// Put `wanted` into `parent`, in order, without moving what is in place already: the focus stays where it is.
export function arrange(parent, wanted) {
  const keep = new Set(wanted);
  for (const child of [...parent.childNodes]) {
    if (!keep.has(child)) {
      child.remove();
    }
  }
  wanted.forEach((child, k) => {
    if (parent.childNodes[k] !== child) {
      parent.insertBefore(child, parent.childNodes[k] ?? null);
    }
  });
  return parent;
}

let made = 0;

// One table. `columns` are {key, title, label, list, placeholder, wide, choices}; `changed(row, column, text)` writes a cell and `added(values)`
// the values of the last row, both by promises whose errors are told in place. What is typed and cannot be written stays in its cell.
export class Cells {
  constructor(words, {changed, added, removed, chosen = () => {}, addWords = "Add", first = "name", writable = true}) {
    Object.assign(this, {words, changed, added, removed, chosen, addWords, first, writable});
    this.cells = new Map();
    this.rows = new Map();
    this.columns = [];
    this.head = h("tr");
    this.body = h("tbody");
    this.box = h(
      "div",
      {class: "wide stack cells", role: "group", "aria-label": words},
      h("table", {}, h("thead", {}, this.head), this.body),
    );
    this.body.addEventListener("keydown", (event) => this.key(event));
  }

  // `rows` are {key, head, cells: {column: text}, mark}; the last row, for what is added, follows them.
  show(columns, rows, start = {}) {
    this.columns = columns;
    this.start = start;
    this.head.replaceChildren(
      h("td", {}, ""),
      ...columns.map((one) => h("th", {scope: "col"}, one.title)),
      h("td", {}, ""),
    );
    const wanted = rows.map((row) => this.row(row.key, row.head, row.cells, row.mark));
    if (this.added && this.writable) {
      wanted.push(this.row("new", "new", start, "new"));
    }
    for (const key of [...this.rows.keys()]) {
      if (key !== "new" && !rows.some((row) => row.key === key)) {
        this.forget(key);
      }
    }
    arrange(this.body, wanted);
  }

  row(key, head, texts, mark) {
    let row = this.rows.get(key);
    if (!row) {
      const isNew = key === "new";
      const button =
        !this.writable || (!isNew && !this.removed)
          ? null
          : isNew
            ? h("button", {class: "small", type: "button", onclick: () => this.add()}, this.addWords)
            : h(
                "button",
                {class: "small", type: "button", "aria-label": `Remove ${head}`, onclick: () => this.removed(key)},
                "Remove",
              );
      row = {
        line: h("tr", {"data-row": key}),
        name: h("th", {scope: "row"}),
        last: h("td", {}, button),
        extra: h("span", {class: "extra"}),
        button,
      };
      row.last.append(row.extra);
      row.line.addEventListener("focusin", () => this.chosen(key));
      this.rows.set(key, row);
    }
    row.name.replaceChildren(h("span", {class: key === "new" ? null : "away"}, head)); // the first cells say it to whoever sees them
    row.line.className = mark || "";
    if (row.button && key !== "new") {
      row.button.setAttribute("aria-label", `Remove ${head}`);
    }
    arrange(row.line, [
      row.name,
      ...this.columns.map((column) => this.cell(key, head, column, texts[column.key] ?? "").place),
      row.last,
    ]);
    return row.line;
  }

  cell(key, head, column, text) {
    const id = `${key}|${column.key}`;
    let cell = this.cells.get(id);
    if (!cell) {
      const note = h("span", {class: "note wrong", id: `cell-${++made}`});
      const input = column.choices
        ? h(
            "select",
            {disabled: !this.writable},
            column.choices.map(([value, words]) => h("option", {value}, words)),
          )
        : h("input", {
            spellcheck: "false",
            autocomplete: "off",
            readonly: !this.writable,
            list: column.list || null,
            placeholder: column.placeholder || null,
          });
      cell = {
        input,
        note,
        place: h("td", {"data-label": column.title, class: column.wide ? "wide-cell" : null}, input),
        row: key,
        column,
        saved: text,
        tried: null,
      };
      input.cell = cell;
      input.value = text;
      input.addEventListener("change", () => {
        if (key !== "new") {
          this.commit(cell);
        } else {
          this.typed?.(this.values());
        }
      });
      input.addEventListener("input", () => {
        this.clear(cell);
      });
      input.addEventListener("refused", ({detail}) => this.describe(cell, detail));
      this.cells.set(id, cell);
    }
    cell.input.setAttribute(
      "aria-label",
      `${column.label || column.title} of ${key === "new" ? `the new ${this.words}` : head}`,
    );
    if (cell.input.value === cell.saved) {
      cell.input.value = text;
    } // what is typed and not written stays
    if (column.placeholder) {
      cell.input.placeholder = column.placeholder;
    }
    if (!column.choices) {
      cell.input.size = Math.max(column.wide ? 14 : 7, Math.min(column.wide ? 60 : 14, cell.input.value.length + 1));
    }
    cell.saved = text;
    return cell;
  }

  forget(key) {
    this.rows.delete(key);
    for (const id of [...this.cells.keys()]) {
      if (id.startsWith(`${key}|`)) {
        this.cells.delete(id);
      }
    }
  }

  clear(cell) {
    cell.input.removeAttribute("aria-invalid");
    cell.input.removeAttribute("aria-describedby");
    cell.note.remove();
    cell.tried = null;
  }

  describe(cell, words) {
    cell.note.textContent = words;
    cell.place.append(cell.note);
    cell.input.setAttribute("aria-describedby", cell.note.id);
  }

  async commit(cell) {
    const text = cell.input.value;
    if (text === cell.saved) {
      this.clear(cell);
      return;
    }
    if (text === cell.tried) {
      return;
    }
    this.clear(cell);
    cell.tried = text;
    try {
      await this.changed(cell.row, cell.column.key, text.trim());
      forgetTyped(cell.input);
    } catch (error) {
      if (cell.input.value === text) {
        refuseTyped(cell.input, error.message);
      }
    }
  }

  values() {
    return Object.fromEntries(
      this.columns.map((column) => [column.key, this.cells.get(`new|${column.key}`).input.value.trim()]),
    );
  }

  // The last row is written and emptied at once, so that typing goes on; it is filled again if it is refused.
  async add() {
    const values = this.values(),
      own = this.columns.map((column) => this.cells.get(`new|${column.key}`));
    for (const cell of own) {
      this.clear(cell);
    }
    let done = null;
    try {
      done = this.added(values);
    } catch (error) {
      const {input} = own.find((cell) => cell.column.key === error.column) ?? own[0];
      refuseTyped(input, error.message);
      input.focus();
      return;
    }
    for (const cell of own) {
      cell.input.value = cell.saved = this.start[cell.column.key] ?? "";
    }
    this.focus("new", this.first);
    try {
      await done;
    } catch (error) {
      own.forEach((cell) => {
        cell.input.value = values[cell.column.key];
      });
      refuseTyped(own[0].input, error.message);
    }
  }

  fill(values) {
    for (const [key, text] of Object.entries(values)) {
      const cell = this.cells.get(`new|${key}`);
      if (cell) {
        cell.input.value = text;
        cell.input.dispatchEvent(new Event("input", {bubbles: true})); // as if it were typed
      }
    }
  }

  key(event) {
    const cell = event.target.cell;
    if (!cell) {
      return;
    }
    if (event.key === "Enter") {
      event.preventDefault();
      if (cell.row === "new") {
        this.add();
      } else {
        this.commit(cell);
        this.step(cell, 1);
      }
    } else if (event.key === "Escape") {
      cell.input.value = cell.saved;
      this.clear(cell);
    } else if (
      ["ArrowDown", "ArrowUp"].includes(event.key) &&
      !cell.column.choices &&
      !event.altKey &&
      !(cell.column.list && event.target.value === "")
    ) {
      event.preventDefault();
      this.step(cell, event.key === "ArrowDown" ? 1 : -1);
    }
  }

  // The same column, one row down or up.
  step(cell, way) {
    const lines = [...this.body.children],
      next = lines[lines.findIndex((line) => line.dataset.row === cell.row) + way];
    if (next) {
      const other = this.cells.get(`${next.dataset.row}|${cell.column.key}`);
      other?.input.focus();
      other?.input.select?.();
    }
  }

  focus(key, column) {
    this.cells.get(`${key}|${column}`)?.input.focus();
  }
}
