// The records of a study: where they stand in its file, and the edits that add one, take its place or take it out.
import {field, h, options} from "./dom.js";

// What a file may not say about itself: key, words.
export const MAPPING = [
  ["sampling_rate", "Samples a second, Hz"], ["channels", "Channels, as in 2Y, 3Y"], ["quantities", "Quantities, as in force, acceleration"], ["units", "Units, as in N, g"],
  ["columns", "Columns of a CSV, as in acc_1, acc_2"], ["time_column", "Its column of times"], ["array", "Array by name"], ["frequency_array", "Array of frequencies"], ["coherence_array", "Array of coherences"], ["outputs", "Sensors of the FRFs"], ["inputs", "Loads of the FRFs"], ["kind", "receptance, mobility or accelerance"], ["unit", "Unit of the FRFs"],
];
export const LISTS = ["columns", "channels", "quantities", "units", "outputs", "inputs"];

export const records = (app) => [app.now?.table?.record ?? []].flat();
export const recordPath = (app) => (Array.isArray(app.now.table.record) ? ["record", app.record] : ["record"]);
export const besideStudy = (app) => (app.study.includes("/") ? app.study.slice(0, app.study.lastIndexOf("/") + 1) : "");
export const fileOf = (app, record) => besideStudy(app) + [record.path, ...(record.repeats || [])].filter(Boolean)[0];

// What the study says of the same file.
export function givenOptions(app, path) {
  const record = records(app).find((one) => fileOf(app, one) === path);
  return Object.fromEntries(Object.entries(record || {}).filter(([key]) => MAPPING.some(([name]) => name === key) || ["start", "stop", "longest_gap", "csv"].includes(key)));
}

// Edits that make a record of `keys` and of `tables` in it: `instead` of the shown one, and `beside` those there are.
export function recordEdits(app, keys, tables = {}) {
  const n = records(app).length, several = Array.isArray(app.now?.table?.record);
  const within = (place) => Object.entries(tables).flatMap(([name, own]) => Object.entries(own).map(([key, to]) => ({set: [...place, name, key], to})));
  const plain = [...Object.entries(keys).map(([key, to]) => ({set: ["record", key], to})), ...within(["record"])];
  const added = (count) => [{add: ["record"], table: keys}, ...within(["record", count])];
  if (!n) { return {instead: plain, beside: null}; }
  if (several) { return {instead: [{remove: ["record", app.record]}, ...added(n - 1)], beside: added(n)}; }
  return {instead: [{remove: ["record"]}, ...plain], beside: [{list: ["record"]}, ...added(1)]};
}

export const recordName = (record, k) => `${k + 1}: ${record.name || [record.path, ...(record.repeats || [])].filter(Boolean).join(", ")}`;

// Which of several records is shown; nothing where there is one.
export function recordPicker(app) {
  const all = records(app);
  return all.length < 2 ? null : h("div", {class: "row"}, field("Record of the study", h("select", {id: "shown-record", onchange: (event) => { app.record = Number(event.target.value); app.go(app.step); }},
    options(all.map((one, k) => [String(k), recordName(one, k)]), String(app.record)))));
}
