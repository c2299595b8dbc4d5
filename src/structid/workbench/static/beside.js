// Measured modes beside those of the open study's model: frequencies side by side, and the MAC of every pair.
import {post} from "./api.js";
import {field, fill, h, number, options, percent, table, warningList} from "./dom.js";

const FOUND = "found";

// A card that holds what `found()` gives (modes on the page; null where there are none) or a file of modes against the model.
export function besideCard(app, found) {
  const box = h("section", {class: "card", id: "beside"}),
    place = h("div", {"aria-live": "polite"});
  const measured = h("select", {id: "measured"}),
    at = h("select", {id: "at"});
  const button = h(
    "button",
    {type: "button", onclick: () => app.doing(button, () => compare())},
    "Hold against the model",
  );
  const compare = async () => {
    const given = measured.value === FOUND ? found() : measured.value;
    fill(place, h("p", {class: "muted"}, "Computing the model's modes…"));
    try {
      fill(place, pairs(await post("beside", {study: app.study, number: app.record, measured: given, at: at.value})));
    } catch (error) {
      fill(place);
      throw error;
    }
  };
  const draw = (chosen) => {
    const files = app.folder.records.filter((one) => one.modes).map((one) => one.path);
    const results = app.folder.results.map((one) => one.path);
    if (!app.study) {
      fill(
        box,
        h("h2", {}, "Beside the model"),
        h("p", {class: "muted"}, "Open a study above to compare modes with its model."),
      );
      return;
    }
    const choices = [...(found() ? [[FOUND, "the modes taken above"]] : []), ...files];
    fill(measured, options(choices, chosen || measured.value));
    fill(at, options([["", "start values"], ...results], at.value));
    fill(
      box,
      h("h2", {}, "Beside the model"),
      choices.length
        ? h("div", {class: "row end"}, field("Measured modes", measured), field("The model has", at), button)
        : h(
            "p",
            {class: "muted"},
            "No modes yet: find those of a record above, or drop a file of modes on the start page.",
          ),
      place,
    );
  };
  draw();
  return {
    box,
    draw,
    compare: (chosen) => {
      draw(chosen);
      return compare();
    },
  };
}

function pairs(told) {
  const rows = told.frequency.map((f, i) => {
    const pair = told.pair[i],
      model = pair === null ? null : told.model[pair];
    return [
      `${i + 1}`,
      number(f, 5),
      number(model, 5),
      model === null ? "–" : percent(told.difference[i], 2),
      pair === null ? "–" : number(told.mac[i][pair], 3),
      told.remarks[i],
    ];
  });
  return [
    h(
      "p",
      {},
      `${told.pair.filter((one) => one !== null).length} of ${told.frequency.length} measured modes match modes of the model, by ${told.sensors} sensors.`,
    ),
    table(
      ["measured", "Hz", "model, Hz", "model is higher by", "MAC", "remark"],
      rows,
      [1, 2, 3, 4],
      told.pair.map((one) => (one === null ? "doubtful" : null)),
    ),
    told.warnings.length ? warningList(told.warnings) : null,
    h("h3", {}, "MAC of every pair"),
    map(told),
    h(
      "p",
      {class: "note"},
      "A row is a measured mode, a column one of the model. Framed: the pairs; close modes are framed together.",
    ),
  ];
}

function map(told) {
  const title = (k) => `${told.number[k]}: ${number(told.model[k], 4)} Hz`;
  return h(
    "div",
    {
      class: "wide",
      tabindex: 0,
      role: "group",
      "aria-label": "MAC of every measured mode with every mode of the model",
    },
    h(
      "table",
      {class: "mac"},
      h(
        "thead",
        {},
        h(
          "tr",
          {},
          h("td", {}),
          told.model.map((_, k) => h("th", {scope: "col"}, title(k))),
        ),
      ),
      h(
        "tbody",
        {},
        told.mac.map((row, i) =>
          h(
            "tr",
            {},
            h("th", {scope: "row"}, `${i + 1}: ${number(told.frequency[i], 4)} Hz`),
            row.map((value, k) => {
              const isPair = told.together[i].includes(k);
              return h(
                "td",
                {
                  class: isPair ? "pair" : null,
                  style: {"--part": `${Math.round(45 * value)}%`},
                  title: `measured ${i + 1}, model ${title(k)}${isPair ? ", a pair" : ""}`,
                },
                value === null ? "–" : value.toFixed(2),
              );
            }),
          ),
        ),
      ),
    ),
  );
}
