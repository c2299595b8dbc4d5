// Sensors and loads of a plan in *Build*: two lists of degrees of freedom.
import {field, fill, h} from "../dom.js";
import {actions} from "../study_structure.js";
import {forgetTyped, refuseTyped} from "../typed.js";

// Key of the study's plan, its title, and the attribute of the model that has it.
const LISTS = [
  ["installed_sensors", "Sensors", "sensors"],
  ["installed_loads", "Loads", "loads"],
];

export function planPlaces({editor, run, writable}) {
  const note = h("p", {class: "note"});
  const tell = (refused = "") => fill(note, refused ? h("span", {class: "wrong"}, refused) : placesWords(editor.model));
  const inputs = LISTS.map(([key, title, attribute]) => {
    const input = h("input", {
      spellcheck: "false",
      readonly: !writable,
      placeholder: "such as 3X, 5Y",
      "data-label": title,
    });
    input.addEventListener("change", () => {
      tell();
      writeList(input, run, key);
    });
    input.addEventListener("refused", ({detail}) => tell(detail));
    return [input, title, attribute];
  });
  const fields = inputs.map(([input, title]) => field(title, input, "wide-field"));
  const section = h(
    "section",
    {class: "card", id: "plan-places"},
    h("h2", {}, "Sensors and loads"),
    h("div", {class: "row end"}, fields),
    note,
  );
  return {
    section,
    draw: () => {
      for (const [input, , attribute] of inputs) {
        if (!input.hasAttribute("aria-invalid") && document.activeElement !== input) {
          input.value = editor.model[attribute].join(", ");
        }
      }
      if (!section.querySelector("[aria-invalid]")) {
        tell();
      }
    },
  };
}

const placesWords = (model) =>
  model.hasRecord
    ? "Those of the record are placed in step Structure; these are for a plan."
    : "Where the test is to measure and to push: node and direction, as in 3X. A click on a node in step Structure does the same.";

function writeList(input, run, key) {
  const list = input.value.split(/[,;\s]+/).filter(Boolean);
  try {
    run((model) => actions.setPlan(model, key, list)).then(
      () => forgetTyped(input),
      (error) => refuseTyped(input, error.message),
    );
  } catch (error) {
    refuseTyped(input, error.message);
  }
}
