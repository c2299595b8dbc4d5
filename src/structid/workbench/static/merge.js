// Modes of several set-ups with common reference sensors, merged to shapes at all sensors.
import {post} from "./api.js";
import {checkbox, field, fill, h, number, table, warningList, writing} from "./dom.js";

// A card that merges records, or files of modes; `saved` hears the answer and the folder.
export function mergeCard(app, given, band, saved) {
  const box = h("section", {class: "card", id: "merge"}),
    place = h("div", {"aria-live": "polite"}),
    chosen = new Set();
  const name = h("input", {value: "merged_modes", spellcheck: "false"});
  const buttons = writing(app, "Merge", name, async (replace) => {
    fill(place, h("p", {class: "muted"}, "Merging… modes of records are found first."));
    try {
      const found = await post("merge", {
        records: app.folder.records.map((one) => one.path).filter((path) => chosen.has(path)),
        options: given(),
        out: name.value,
        band: band(),
        replace,
      });
      await app.reload();
      fill(place, merged(found));
      saved(found, name.value);
    } catch (error) {
      fill(place);
      throw error;
    }
  });
  const draw = () => {
    const files = app.folder.records.map((one) => one.path);
    for (const path of [...chosen]) {
      if (!files.includes(path)) {
        chosen.delete(path);
      }
    }
    const off = () => {
      buttons[0].disabled = chosen.size < 2 || !app.folder.writable;
    };
    fill(
      box,
      h("h2", {}, "Merge set-ups"),
      h(
        "p",
        {class: "note"},
        "Records of one structure that share reference sensors, or the modes saved of each: shapes at all sensors together, frequencies as their weighted mean.",
      ),
      files.length < 2
        ? h("p", {class: "muted"}, "It takes two records or two files of modes.")
        : h(
            "fieldset",
            {},
            h("legend", {}, "Set-ups"),
            files.slice(0, 200).map((path) =>
              checkbox(
                chosen.has(path),
                (isOn) => {
                  chosen[isOn ? "add" : "delete"](path);
                  off();
                },
                path,
              ),
            ),
          ),
      files.length < 2 ? null : h("div", {class: "row end"}, field("Folder of the merged modes", name), buttons),
      place,
    );
    off();
  };
  draw();
  return {box, draw};
}

function merged(found) {
  const each = found.setups;
  const rows = found.frequency.map((f, k) => [
    String(k + 1),
    number(f, 6),
    number(found.frequency_std[k], 2),
    number(found.damping[k], 3),
    ...(each ? [each[k].map((x) => number(x, 5)).join(", ")] : []),
  ]);
  return h(
    "div",
    {},
    h("p", {}, `${found.frequency.length} modes that all set-ups have, at ${found.channels.length} sensors.`),
    table(["mode", "Hz", "std", "damping ratio", ...(each ? ["of each set-up, Hz"] : [])], rows, [1, 2, 3]),
    found.warnings.length ? warningList(found.warnings) : null,
  );
}
