// Values of a beam or bar from its material and cross-section, into a row of its table.
import {post} from "../api.js";
import {field, fill, h, options} from "../dom.js";
import {shownNumber} from "../study_structure.js";

// The folded form under a table; `write` gives the values to the element set of a row. It adds `sets` to `cells`: their choice.
export function sectionValues({app, sections, writable}, type, cells, write) {
  const material = h("select", {"data-kept": true}, options(sections.materials)),
    shape = h("select", {"data-kept": true, onchange: () => sizes()}, options(sections.shapes.map((one) => one.name))),
    inputs = h("div", {class: "row end"}),
    turned = h("input", {type: "checkbox", "data-kept": true}),
    row = h("select", {"data-kept": true});
  const sizes = () => fill(inputs, sizeFields(sections.shapes.find((one) => one.name === shape.value)));
  const given = () => ({
    element: type,
    material: material.value,
    shape: shape.value,
    sizes: Object.fromEntries([...inputs.querySelectorAll("input")].map((one) => [one.name, one.value.trim()])),
    is_turned: turned.checked,
  });
  const take = h(
    "button",
    {
      type: "button",
      disabled: !writable,
      onclick: () => app.doing(take, () => fillRow(cells, row.value, given(), write)),
    },
    "Take its values",
  );
  sizes();
  cells.sets = (sets) => offerRows(row, sets);
  const turnedWords = type === "beam" ? "lying on its side" : "width along local y";
  return h(
    "details",
    {class: "preset", "data-kept": true},
    h("summary", {}, "Values from material and cross-section"),
    h(
      "div",
      {class: "row end"},
      field("Material", material),
      field("Cross-section", shape),
      inputs,
      type === "bar" ? null : h("label", {class: "check"}, turned, turnedWords),
      field("for", row),
      take,
    ),
  );
}

const sizeFields = (shape) =>
  Object.entries(shape.sizes).map(([name, size]) =>
    field(`${name}, mm`, h("input", {name, value: String(size), inputmode: "decimal"}), "short"),
  );

async function fillRow(cells, row, given, write) {
  const values = await post("sections", given);
  if (row === "new") {
    cells.fill(Object.fromEntries(Object.entries(values).map(([key, value]) => [key, shownNumber(value)])));
    cells.focus("new", "name");
  } else {
    await write(row, values);
  }
}

// The choice stays where it is still offered.
function offerRows(row, sets) {
  fill(row, options([["new", "the new row"], ...sets.map((one) => [String(one.k), one.name])], row.value));
}
