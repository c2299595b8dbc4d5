// Elements from names, attributes and children. Texts are texts: nothing that a file says becomes markup.
import {forgetTyped, refuseTyped} from "./typed.js";

export function h(tag, given = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (value === undefined || value === null || value === false) {
      continue;
    }
    if (key.startsWith("on")) {
      made.addEventListener(key.slice(2), value);
    } else if (key === "value" || key === "checked" || key === "disabled" || key === "selected") {
      made[key] = value;
    } else if (key === "style") {
      for (const [name, part] of Object.entries(value)) {
        made.style.setProperty(name, part);
      }
    } else {
      made.setAttribute(key, value === true ? "" : String(value));
    }
  }
  made.append(...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

export function fill(place, ...children) {
  place.replaceChildren(
    ...children.flat(3).filter((child) => child !== null && child !== undefined && child !== false),
  );
  return place;
}

// Words with what stands between back quotes as code.
export const marked = (words) => words.split("`").map((part, k) => (k % 2 ? h("code", {}, part) : part));

// Warnings as a list.
export const warningList = (lines) =>
  h(
    "ul",
    {class: "warnings"},
    lines.map((words) => h("li", {}, marked(words))),
  );

// Why something was refused, in a box that wraps.
export const refusal = (words) => h("p", {class: "state bad", style: {"white-space": "normal"}}, marked(words));

// A button that writes into the folder that `name` holds, and one that replaces what is there, shown where that is refused.
export function writing(app, words, name, write, given = {}) {
  const act = (button, replace) =>
    app.doing(button, async () => {
      again.hidden = true;
      try {
        await write(replace);
        forgetTyped(name);
      } catch (error) {
        again.hidden = error.status !== 409;
        fill(again, `Replace ${name.value}`);
        throw error;
      }
    });
  const again = h("button", {type: "button", hidden: true, onclick: () => act(again, true)});
  const first = h("button", {type: "button", ...given, onclick: () => act(first, false)}, words);
  name.addEventListener("input", () => {
    again.hidden = true;
  });
  return [first, again];
}

let made = 0;

export function field(label, control, kind = "") {
  control.id = control.id || `field-${++made}`;
  return h("div", {class: "field " + kind}, h("label", {for: control.id}, label), control);
}

// A box to tick before some words; `changed` hears whether it is ticked.
export function checkbox(isOn, changed, ...words) {
  const input = h("input", {type: "checkbox", checked: isOn, onchange: (event) => changed(event.target.checked)});
  return h("label", {class: "check"}, input, ...words);
}

export function options(values, chosen) {
  return values.map((one) => {
    const [value, words] = Array.isArray(one) ? one : [one, one];
    return h("option", {value, selected: value === chosen}, words);
  });
}

// Long names break after underscores and before brackets.
const broken = (content) =>
  typeof content === "string" && content.length > 12
    ? content.split(/(?<=_)|(?=\[)/).flatMap((part, k) => (k ? [document.createElement("wbr"), part] : [part]))
    : content;

export function table(header, rows, numeric = [], marks = []) {
  const cell = (tag, content, k) =>
    h(
      tag,
      {
        class: numeric.includes(k) ? "number" : k === 0 ? "name" : null,
        scope: tag === "th" ? "col" : null,
        "data-label": tag === "td" && (k || numeric.includes(k)) ? header[k] : null,
      },
      broken(content),
    );
  return h(
    "div",
    {
      class: header.length > 3 ? "wide stack" : "wide",
      tabindex: 0,
      role: "group",
      "aria-label": "Table: " + header.filter((x) => typeof x === "string" && x).join(", "),
    },
    h(
      "table",
      {},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          header.map((content, k) => (content === "" ? h("td", {}) : cell("th", content, k))),
        ),
      ),
      h(
        "tbody",
        {},
        rows.map((row, r) =>
          h(
            "tr",
            {class: marks[r] || null},
            row.map((content, k) => cell("td", content, k)),
          ),
        ),
      ),
    ),
  );
}

function refused(input, words) {
  refuseTyped(input, words);
  input.focus();
  throw new Error(`${input.labels?.[0]?.textContent || input.getAttribute("aria-label")}: ${words}`);
}

// The number in a field; null where an empty one is allowed. Anything else is refused there.
export function numberIn(input, {least = -Infinity, empty = false} = {}) {
  const text = input.value.trim(),
    value = Number(text);
  if (!text) {
    return empty ? null : refused(input, "give a number");
  }
  if (!Number.isFinite(value)) {
    refused(input, `${text} is no number${/^[^,]*\d,\d+$/.test(text) ? `; write ${text.replace(",", ".")}` : ""}`);
  }
  return value < least ? refused(input, `must be at least ${least}`) : value;
}

// The band in two fields; null where both may be empty, and are.
export function bandIn(low, high, empty = false) {
  const ends = [
    numberIn(low, {least: 0, empty: empty && !high.value.trim()}),
    numberIn(high, {least: 0, empty: empty && !low.value.trim()}),
  ];
  if (ends[0] === null) {
    return null;
  }
  return ends[0] < ends[1] ? ends : refused(high, `must be greater than ${ends[0]}`);
}

export const SUPERSCRIPT = {0: "⁰", 1: "¹", 2: "²", 3: "³", 4: "⁴", 5: "⁵", 6: "⁶", 7: "⁷", 8: "⁸", 9: "⁹", "-": "⁻"};
const raised = (text) => [...text].map((letter) => SUPERSCRIPT[letter] || letter).join("");

export function unitText(unit) {
  return unit === "1" || !unit ? "" : unit.replace(/\^(-?\d+)/g, (_, power) => raised(power));
}

export const withUnit = (words, unit) => (unitText(unit) ? `${words}, ${unitText(unit)}` : words);

export function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) {
    return "–";
  }
  if (value === 0) {
    return "0";
  }
  const power = Number(value.toExponential(digits - 1).split("e")[1]);
  if (power >= -3 && power < 5) {
    return value.toFixed(Math.max(digits - 1 - power, 0)).replace("-", "−");
  }
  return (value / 10 ** power).toFixed(digits - 1).replace("-", "−") + "×10" + raised(String(power));
}

const PREFIXES = {9: "G", 6: "M", 3: "k"};

// A value with an engineering prefix before units of force or pressure: 25.0 MN m².
export function quantity(value, unit, digits = 4) {
  if (!Number.isFinite(value)) {
    return "–";
  }
  const power = Math.min(9, 3 * Math.floor(Math.log10(Math.abs(Number(value.toPrecision(digits))) || 1) / 3));
  if (!/^(N|Pa)\b(?!\/N)/.test(unit || "") || power < 3) {
    return `${number(value, digits)} ${unitText(unit)}`.trim();
  }
  return `${number(value / 10 ** power, digits)} ${PREFIXES[power]}${unitText(unit)}`;
}

// A number for a field that is typed into: no more digits than it has.
export const typed = (value, digits = 6) => String(Number(value.toPrecision(digits)));

export function percent(part, digits = 2) {
  if (part === null || part === undefined || !Number.isFinite(part)) {
    return "not determined";
  }
  return part > 10 ? "> 1000 %" : number(100 * part, digits) + " %";
}

export function bytes(count) {
  return count < 1e6
    ? `${Math.max(1, Math.round(count / 1e3))} kB`
    : count < 1e9
      ? `${(count / 1e6).toFixed(1)} MB`
      : `${(count / 1e9).toFixed(2)} GB`;
}

export function clock(seconds) {
  if (seconds < 60) {
    return `${Number(seconds.toPrecision(2))} s`;
  }
  return seconds < 3600
    ? `${Math.floor(seconds / 60)} min ${Math.floor(seconds % 60)} s`
    : `${Math.floor(seconds / 3600)} h ${Math.floor((seconds % 3600) / 60)} min`;
}

const KINDS = {f32: Float32Array, f64: Float64Array, i32: Int32Array, u32: Uint32Array, u8: Uint8Array};

export function unpacked(text, kind) {
  const raw = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new KINDS[kind](raw.buffer);
}

export const toml = (value) =>
  Array.isArray(value)
    ? `[${value.map(toml).join(", ")}]`
    : typeof value === "string"
      ? JSON.stringify(value)
      : typeof value === "number" && Number.isInteger(value)
        ? value.toFixed(1)
        : String(value);
