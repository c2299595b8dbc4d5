// Text that is typed and not taken yet: it stands in its field again, with what is wrong of it, when a step is drawn anew or opened again.
// So do choices in lists, tick boxes and folds that are marked `data-kept`.
const CARDS = "[data-typed], [data-record], [data-row], [data-offer], section, [id]";
const texts = new Map(), // by step and study, card and label: {field, text, words}
  choices = new Map(), // by the same keys: {field, value}
  keys = new WeakMap(),
  before = new WeakMap(); // of a field: what stood there before it was typed into
let whatIsShown = () => "",
  focused = null;

export const isTyped = (field) =>
  field.matches?.("input:not([type=checkbox], [type=radio], [type=file]), textarea") && !field.closest(".editor");

const isKept = (field) => field.matches?.("[data-kept]");
const isFold = (field) => field.matches("details");

// What is chosen in a list, or whether a box is ticked or a fold open, as a text.
function stateOf(field) {
  if (field.matches("select")) {
    return JSON.stringify([...field.selectedOptions].map((one) => one.value));
  }
  return String(isFold(field) ? field.open : field.checked);
}

// Give a control the state `value`; false where its list does not offer that.
function putState(field, value) {
  if (!field.matches("select")) {
    field[isFold(field) ? "open" : "checked"] = value === "true";
    return true;
  }
  const chosen = JSON.parse(value),
    all = [...field.options];
  if (!chosen.every((name) => all.some((one) => one.value === name))) {
    return false;
  }
  for (const one of all) {
    one.selected = chosen.includes(one.value);
  }
  return true;
}

function keyOf(field) {
  if (!keys.has(field)) {
    const card = field.parentElement?.closest(CARDS),
      label =
        field.getAttribute("aria-label") ??
        field.labels?.[0]?.textContent ??
        field.querySelector("summary")?.textContent ??
        field.name,
      name = Object.values(card?.dataset ?? {}).join(" ") || card?.id || "";
    keys.set(field, [whatIsShown(), name, label].join("\n"));
  }
  return keys.get(field);
}

// Keep what is typed within `place`; `shown()` names the step and the study that it shows.
export function keepTyped(place, shown) {
  whatIsShown = shown;
  place.addEventListener("focusin", ({target, isTrusted}) => {
    if (isTrusted) {
      focused = null;
    }
    if (isTyped(target) && !texts.has(keyOf(target))) {
      before.set(target, target.value);
    }
  });
  place.addEventListener("input", ({target}) => {
    target.removeAttribute("aria-invalid");
    if (!isTyped(target)) {
      return;
    }
    if (target.value === before.get(target)) {
      texts.delete(keyOf(target));
    } else {
      texts.set(keyOf(target), {field: target, text: target.value, words: ""});
    }
  });
  for (const name of ["change", "toggle"]) {
    place.addEventListener(
      name,
      ({target}) => {
        if (isKept(target)) {
          choices.set(keyOf(target), {field: target, value: stateOf(target)});
        }
      },
      true, // a fold tells nobody above it
    );
  }
  new MutationObserver((changes) => {
    for (const node of changes.flatMap((change) => [...change.addedNodes])) {
      if (node.isConnected && node.querySelectorAll) {
        const inside = [node, ...node.querySelectorAll("input, textarea, [data-kept]")];
        inside.filter(isTyped).forEach(restore);
        new Set([...inside.filter(isKept), node.closest("select[data-kept]")]).forEach(restoreChoice);
      }
    }
  }).observe(place, {childList: true, subtree: true});
}

function restore(field) {
  const key = keyOf(field),
    kept = texts.get(key);
  if (kept && kept.field !== field) {
    if (kept.field.value !== kept.text) {
      texts.delete(key); // the page itself wrote another text there
    } else if (!field.readOnly && !field.disabled) {
      before.set(field, field.value);
      field.value = kept.text;
      field.dispatchEvent(new Event("input", {bubbles: true}));
      if (kept.words) {
        refuseTyped(field, kept.words);
      } else {
        field.addEventListener("blur", () => takeRestored(field, key), {once: true});
      }
    }
  }
  focusAgain(field, key);
}

function focusAgain(field, key) {
  if (focused?.key === key && document.activeElement === document.body) {
    const {start, end} = focused;
    field.focus();
    if (start !== null && field.type !== "number") {
      field.setSelectionRange(start, end);
    }
  }
}

// A list gets its choice again once it has that choice to offer.
function restoreChoice(field) {
  if (!field) {
    return;
  }
  focusAgain(field, keyOf(field));
  const kept = choices.get(keyOf(field));
  if (kept?.field === field) {
    kept.value = stateOf(field); // its list was filled anew, and may offer that choice no more
  }
  if (!kept || kept.field === field || field.disabled) {
    return;
  }
  const isNew = stateOf(field) !== kept.value;
  if (isNew && !putState(field, kept.value)) {
    return;
  }
  kept.field = field;
  if (isNew && !isFold(field)) {
    field.dispatchEvent(new Event("change", {bubbles: true}));
  }
}

// A browser tells of no change in a field whose text was put back and not typed into since.
function takeRestored(field, key) {
  if (texts.get(key)?.field === field && field.isConnected && field.value !== before.get(field)) {
    field.dispatchEvent(new Event("change", {bubbles: true}));
  }
}

// Mark a field whose text cannot be taken; the words are told at the field where its table hears of it.
export function refuseTyped(field, words) {
  const kept = texts.get(keyOf(field));
  if (kept) {
    kept.words = words;
  }
  field.setAttribute("aria-invalid", "true");
  field.dispatchEvent(new CustomEvent("refused", {detail: words}));
}

// A field's text, or those of the card in which a button stands, are taken.
export function forgetTyped(control) {
  const fields = isTyped(control)
    ? [control]
    : [...(control.parentElement?.closest(CARDS)?.querySelectorAll("input, textarea") ?? [])].filter(isTyped);
  for (const field of fields) {
    texts.delete(keyOf(field));
    before.delete(field);
  }
  if (!isTyped(control)) {
    const kept = control.parentElement?.closest(CARDS)?.querySelectorAll("[data-kept]:not(details)") ?? [];
    kept.forEach((field) => choices.delete(keyOf(field)));
  }
}

// The field that is typed into has the focus again once it is drawn anew.
export function keepFocus() {
  const field = document.activeElement;
  focused =
    isTyped(field) || isKept(field)
      ? {key: keyOf(field), start: field.selectionStart ?? null, end: field.selectionEnd}
      : null;
}
