// The [structure] of a study as the editor knows it, and the edits that change it. No element of the page is touched here.

export const DIRECTIONS = ["X", "Y", "Z", "RX", "RY", "RZ"];
const IN_A_PLANE = ["X", "Y", "RZ"];
// Element tables that the editor edits, in the order in which it shows them.
export const LINES = ["beam", "bar", "space_beam"];
const EDITED = [...LINES, "point_mass", "spring"];
// Tables whose nodes come from elsewhere.
const IMPORTED = ["mesh", "matrices", "matrix_group", "solver"];
const listed = (value) => (value === undefined ? [] : [value].flat());
const several = (value) => (Array.isArray(value) ? value : value === undefined ? [] : [value]);

// A copy of a study's parsed table after `edits` (as in structid.study.schema.edits), whose values are written as JSON writes them.
export function applied(table, edits) {
  const copy = structuredClone(table ?? {});
  for (const edit of edits) {
    const path = edit.set || edit.remove || edit.add,
      last = path.at(-1);
    let holder = copy;
    path.slice(0, -1).forEach((part, k) => {
      holder = holder[part] ??= typeof path[k + 1] === "number" ? [] : {};
    });
    if (edit.set) {
      holder[last] = JSON.parse(edit.to);
    } else if (edit.add) {
      holder[last] = [
        ...several(holder[last]),
        Object.fromEntries(Object.entries(edit.table).map(([key, value]) => [key, JSON.parse(value)])),
      ];
    } else if (Array.isArray(holder)) {
      holder.splice(last, 1);
    } else {
      delete holder[last];
    }
  }
  return copy;
}

// Degrees of freedom of one text: "3X", "3X-", "3 X RZ", or "3", all six of it; null where it is none.
export function parseDofs(text) {
  const found = /^\s*(\d+)\s*[:_]?\s*((?:[+-]?R?[XYZ][+-]?\s*)*)$/i.exec(text);
  if (!found) {
    return null;
  }
  const directions = found[2].toUpperCase().match(/R?[XYZ]/g) || [];
  return {node: Number(found[1]), directions: directions.length ? directions : DIRECTIONS};
}

// A model of nodes and elements from the parsed study.
export function readStructure(table) {
  const own = table?.structure ?? {},
    nodes = new Map();
  for (const [label, at] of Object.entries(own.nodes ?? {})) {
    nodes.set(Number(label), listed(at));
  }
  const first = nodes.size ? nodes.values().next().value.length : 0,
    stated = own.active;
  const dimension = first || (!stated || stated.includes("Z") ? 3 : stated.includes("X") ? 2 : 1);
  const active = stated ?? (dimension === 3 ? DIRECTIONS : IN_A_PLANE);
  const sets = EDITED.flatMap((type) =>
    several(own[type]).map((entry, k) => ({
      type,
      k,
      name: entry.name,
      entry,
      path: ["structure", type, ...(Array.isArray(own[type]) ? [k] : [])],
    })),
  );
  return {
    dimension,
    active,
    nodes,
    sets,
    fixed: listed(own.fixed).map((text) => ({
      text: String(text),
      ...(parseDofs(String(text)) ?? {node: null, directions: []}),
    })),
    others: Object.entries(own)
      .filter(
        ([key, value]) => Array.isArray(value) && value.some((one) => one?.name !== undefined) && !EDITED.includes(key),
      )
      .map(([key]) => key),
    isImported: IMPORTED.some((key) => key in own),
    sensors: listed(table?.plan?.installed_sensors),
    loads: listed(table?.plan?.installed_loads),
    placed: several(table?.record).map((record) => record.sensors ?? {}),
    unknown: several(table?.unknown),
    hasRecord: table?.record !== undefined,
    hasRecords: Array.isArray(table?.record),
  };
}

// Pairs of nodes of an element set of lines.
export const pairsOf = (set) => (LINES.includes(set.type) ? (set.entry.nodes ?? []) : []);

// "1-2-3, 5-4" as [[1, 2], [2, 3], [5, 4]].
export function parseElements(text) {
  const pairs = [];
  for (const part of text.split(/[,;\s]+/).filter(Boolean)) {
    const chain = part.split(/[-–]/);
    if (chain.length < 2 || chain.some((label) => !/^\d+$/.test(label))) {
      throw new Error(`${part} is no element; write the two nodes as in 1-2, or a chain as in 1-2-3`);
    }
    chain.slice(1).forEach((label, k) => pairs.push([Number(chain[k]), Number(label)]));
  }
  return pairs;
}

export function elementsText(pairs) {
  const chains = [];
  for (const [a, b] of pairs) {
    if (chains.at(-1)?.at(-1) === a) {
      chains.at(-1).push(b);
    } else {
      chains.push([a, b]);
    }
  }
  return chains.map((chain) => chain.join("-")).join(", ");
}

export function parseNodes(text) {
  return text
    .split(/[,;\s]+/)
    .filter(Boolean)
    .map((part) => {
      if (!/^\d+$/.test(part)) {
        throw new Error(`${part} is no number of a node`);
      }
      return Number(part);
    });
}

// A number as it is typed; words on what is wrong with it otherwise.
export function parseNumber(text, words = "") {
  const value = text.trim(),
    comma = /^[^,]*\d,\d+$/.test(value);
  if (!value) {
    throw new Error(`give a number${words}`);
  }
  if (!/^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$/.test(value)) {
    throw new Error(`${value} is no number${comma ? `; write ${value.replace(",", ".")}` : ""}`);
  }
  return Number(value);
}

// A number as it is shown and typed: 4.08e6, 22.4, 3.
export function shownNumber(value) {
  const plain = String(value),
    power = Math.abs(value) >= 1e5 ? value.toExponential().replace("e+", "e") : plain;
  return power.length <= plain.length ? power : plain;
}

// A number as the study has it: never an integer, so that what is typed as 3 stays a length.
export function written(value) {
  if (Array.isArray(value)) {
    return `[${value.map(written).join(", ")}]`;
  }
  const text = shownNumber(value);
  return /[.e]/.test(text) ? text : `${text}.0`;
}

const labels = (list) => `[${list.map((one) => (Array.isArray(one) ? labels(one) : String(one))).join(", ")}]`;
const texts = (list) => `[${list.map((one) => JSON.stringify(one)).join(", ")}]`;
const same = (a, b, size) => a.every((x, k) => Math.abs(x - b[k]) <= 1e-9 * size);

export function sizeOf(model) {
  const all = [...model.nodes.values()];
  return Math.max(
    1e-12,
    ...Array.from(
      {length: model.dimension},
      (_, k) => Math.max(...all.map((at) => at[k])) - Math.min(...all.map((at) => at[k])),
    ).filter(Number.isFinite),
  );
}

// Refuses elements between nodes that are not there, of no length, or (on a line) that run backwards.
function requireLength(model, pairs, name, type = "beam") {
  const size = sizeOf(model);
  for (const pair of pairs) {
    for (const label of pair) {
      if (!model.nodes.has(label)) {
        throw new Error(`there is no node ${label}; add it to the nodes first`);
      }
    }
    const [a, b] = pair.map((label) => model.nodes.get(label));
    if (pair[0] === pair[1] || same(a, b, size)) {
      throw new Error(
        `element ${pair.join("-")}${name ? ` of ${name}` : ""} has no length${pair[0] === pair[1] ? "" : ": its two nodes are at the same place"}`,
      );
    }
    if (model.dimension === 1 && type === "beam" && b[0] < a[0]) {
      throw new Error(`element ${pair.join("-")} runs backwards; on a line, write the end with the smaller x first`);
    }
  }
  const seen = new Set();
  for (const pair of pairs) {
    const key = [...pair].sort((x, y) => x - y).join("-");
    if (seen.has(key)) {
      throw new Error(`element ${key} is there twice`);
    }
    seen.add(key);
  }
}

// Each action is {words, edits}; what cannot be is refused by an Error whose words belong beside the field.
export const actions = {
  addNode(model, label, at, held = []) {
    if (model.nodes.has(label)) {
      throw new Error(`there is a node ${label} already`);
    }
    const place = model.dimension === 1 ? written(at[0]) : written(at),
      support = held.length ? actions.holdNode(model, label, held).edits : [];
    return {words: `node ${label} added`, edits: [{set: ["structure", "nodes", String(label)], to: place}, ...support]};
  },

  moveNode(model, label, at) {
    const moved = {...model, nodes: new Map(model.nodes).set(label, at)};
    for (const set of model.sets) {
      requireLength(
        moved,
        pairsOf(set).filter((pair) => pair.includes(label)),
        set.name,
        set.type,
      );
    }
    return {
      words: `node ${label} moved`,
      edits: [{set: ["structure", "nodes", String(label)], to: model.dimension === 1 ? written(at[0]) : written(at)}],
    };
  },

  // Another number for a node, in all that names it; the study keeps its place among the others.
  renumber(model, label, next) {
    if (!Number.isInteger(next)) {
      throw new Error("give a whole number");
    }
    if (model.nodes.has(next)) {
      throw new Error(`there is a node ${next} already`);
    }
    const edits = [],
      swap = (one) => (Array.isArray(one) ? one.map(swap) : one === label ? next : one);
    const swapText = (text) => (parseDofs(text)?.node === label ? text.replace(/\d+/, String(next)) : text);
    const change = (path, before, after, write) => {
      if (JSON.stringify(before) !== JSON.stringify(after)) {
        edits.push({set: path, to: write(after)});
      }
    };
    for (const set of model.sets) {
      if (set.entry.nodes) {
        change([...set.path, "nodes"], set.entry.nodes, swap(set.entry.nodes), labels);
      }
      for (const key of NAMES) {
        if (set.entry[key] !== undefined) {
          change([...set.path, key], listed(set.entry[key]), listed(set.entry[key]).map(swapText), (list) =>
            literal(key, list),
          );
        }
      }
    }
    change(
      ["structure", "fixed"],
      model.fixed.map((one) => one.text),
      model.fixed.map((one) => swapText(one.text)),
      texts,
    );
    change(["plan", "installed_sensors"], model.sensors, model.sensors.map(swapText), texts);
    change(["plan", "installed_loads"], model.loads, model.loads.map(swapText), texts);
    model.placed.forEach((record, k) => {
      for (const [name, one] of Object.entries(record)) {
        if (one?.node === label) {
          edits.push({set: ["record", ...(model.hasRecords ? [k] : []), "sensors", name, "node"], to: String(next)});
        }
      }
    });
    const at = model.nodes.get(label);
    edits.push(
      {remove: ["structure", "nodes", String(label)]},
      {set: ["structure", "nodes", String(next)], to: model.dimension === 1 ? written(at[0]) : written(at)},
    );
    return {words: `node ${label} is ${next} now`, edits};
  },

  // Directions in which a node is held, in place of those it was held in before.
  holdNode(model, label, directions) {
    const whole = model.active.every((one) => directions.includes(one)) && directions.length > 0;
    const text = !directions.length
      ? []
      : [
          whole
            ? String(label)
            : directions.length === 1
              ? `${label}${directions[0]}`
              : `${label} ${directions.join(" ")}`,
        ];
    const first = model.fixed.findIndex((one) => one.node === label),
      rest = model.fixed.filter((one) => one.node !== label).map((one) => one.text);
    rest.splice(
      first < 0 ? rest.length : model.fixed.slice(0, first).filter((one) => one.node !== label).length,
      0,
      ...text,
    );
    if (!rest.length && !model.fixed.length) {
      return {words: "", edits: []};
    }
    return {
      words: directions.length ? `node ${label} is held` : `node ${label} is free`,
      edits: [rest.length ? {set: ["structure", "fixed"], to: texts(rest)} : {remove: ["structure", "fixed"]}],
    };
  },

  addSet(model, type, values) {
    if (!values.name) {
      throw new Error("give it a name");
    }
    if (model.sets.some((one) => one.name === values.name)) {
      throw new Error(`there is a set ${values.name} already`);
    }
    requireEntry(model, type, values);
    const table = Object.fromEntries(
      Object.entries(values)
        .filter(([, value]) => value !== undefined)
        .map(([key, value]) => [key, literal(key, value)]),
    );
    return {words: `${values.name} added`, edits: [{add: ["structure", type], table}]};
  },

  setValue(model, set, key, value) {
    const entry = {...set.entry, [key]: value};
    requireEntry(model, set.type, entry);
    if (key === "name") {
      return renamed(model, set, value);
    }
    if (value === undefined) {
      return {words: `${key} of ${set.name} left out`, edits: key in set.entry ? [{remove: [...set.path, key]}] : []};
    }
    const edits = [{set: [...set.path, key], to: literal(key, value)}];
    if (key === "nodes" && LINES.includes(set.type)) {
      edits.push(...matchedLists(set, value.length));
    }
    return {words: `${key.replaceAll("_", " ")} of ${set.name} changed`, edits};
  },

  removeSet(model, set) {
    const gone = unknownsOf(model, set.name);
    return {words: `${set.name} removed`, edits: [{remove: set.path}, ...gone.map((k) => ({remove: ["unknown", k]}))]};
  },

  addElement(model, set, pair) {
    if (pairsOf(set).some((one) => pair.every((label) => one.includes(label)))) {
      throw new Error(`element ${pair.join("-")} is there already`);
    }
    return actions.setValue(model, set, "nodes", [...pairsOf(set), pair]);
  },

  // A node with all that hangs on it: `dependentsOf` says in words what that is.
  removeNode(model, label) {
    const edits = [],
      unknown = [];
    const drop = (set, indices) => {
      const left = (set.entry.nodes ?? []).filter((_, k) => !indices.includes(k));
      if (!left.length) {
        edits.unshift({remove: set.path});
        unknown.push(...unknownsOf(model, set.name));
        return;
      }
      edits.push(
        {set: [...set.path, "nodes"], to: labels(left)},
        ...listProperties(set).map((key) => ({
          set: [...set.path, key],
          to: written(set.entry[key].filter((_, k) => !indices.includes(k))),
        })),
      );
    };
    for (const set of [...model.sets].reverse()) {
      // the last first: positions of those before stay what they are
      if (set.type === "spring") {
        const ends = springEnds(set),
          keep = ends.filter((pair) => !pair.some((text) => text !== null && parseDofs(text)?.node === label));
        if (keep.length === ends.length) {
          continue;
        }
        if (!keep.length) {
          edits.unshift({remove: set.path});
          unknown.push(...unknownsOf(model, set.name));
          continue;
        }
        edits.push({set: [...set.path, "first"], to: texts(keep.map(([a]) => a))});
        if (set.entry.second !== undefined) {
          edits.push({set: [...set.path, "second"], to: texts(keep.map(([, b]) => b))});
        }
        continue;
      }
      const indices = (set.entry.nodes ?? []).flatMap((one, k) => (listed(one).includes(label) ? [k] : []));
      if (indices.length) {
        drop(set, indices);
      }
    }
    const removals = edits
      .filter((one) => one.remove)
      .sort((a, b) => ((a.remove[2] ?? 0) < (b.remove[2] ?? 0) ? 1 : -1));
    const all = [
      ...edits.filter((one) => !one.remove),
      ...removals,
      ...[...new Set(unknown)].sort((a, b) => b - a).map((k) => ({remove: ["unknown", k]})),
    ];
    const fixed = model.fixed.filter((one) => one.node !== label).map((one) => one.text);
    if (fixed.length < model.fixed.length) {
      all.push(fixed.length ? {set: ["structure", "fixed"], to: texts(fixed)} : {remove: ["structure", "fixed"]});
    }
    for (const [key, list] of [
      ["installed_sensors", model.sensors],
      ["installed_loads", model.loads],
    ]) {
      const left = list.filter((text) => parseDofs(text)?.node !== label);
      if (left.length < list.length) {
        all.push(left.length ? {set: ["plan", key], to: texts(left)} : {remove: ["plan", key]});
      }
    }
    return {words: `node ${label} removed`, edits: [...all, {remove: ["structure", "nodes", String(label)]}]};
  },

  setPlan(model, key, list) {
    for (const text of list) {
      const dof = parseDofs(text);
      if (!dof || dof.directions.length !== 1) {
        throw new Error(`${text} is no place; write node and direction, as in 3X`);
      }
      if (!model.nodes.has(dof.node)) {
        throw new Error(`there is no node ${dof.node}`);
      }
    }
    return {
      words: "plan changed",
      edits: list.length ? [{set: ["plan", key], to: texts(list)}] : [{remove: ["plan", key]}],
    };
  },
};

export const springEnds = (set) => {
  const second = listed(set.entry.second);
  return listed(set.entry.first).map((text, k) => [String(text), second[k] === undefined ? null : String(second[k])]);
};

const NAMES = ["first", "second"];
const literal = (key, value) =>
  key === "nodes"
    ? labels(value)
    : key === "name"
      ? JSON.stringify(value)
      : NAMES.includes(key)
        ? value.length === 1
          ? JSON.stringify(value[0])
          : texts(value)
        : written(value);
const listProperties = (set) =>
  Object.keys(set.entry).filter(
    (key) =>
      !["nodes", "orientation"].includes(key) &&
      Array.isArray(set.entry[key]) &&
      set.entry[key].every((one) => typeof one === "number"),
  );

// Lists of one value an element follow the number of elements: the last value is repeated.
function matchedLists(set, count) {
  return listProperties(set)
    .filter((key) => set.entry[key].length !== count)
    .map((key) => {
      const values = set.entry[key];
      return {
        set: [...set.path, key],
        to: written(Array.from({length: count}, (_, k) => values[Math.min(k, values.length - 1)])),
      };
    });
}

function requireEntry(model, type, entry) {
  if (LINES.includes(type)) {
    if (!(entry.nodes ?? []).length) {
      throw new Error("name its elements by their nodes, as in 1-2, or click two nodes");
    }
    requireLength(model, entry.nodes, entry.name, type);
    const other = model.sets.find(
      (set) =>
        set.name !== entry.name &&
        LINES.includes(set.type) &&
        pairsOf(set).some((pair) => entry.nodes.some((one) => pair.every((label) => one.includes(label)))),
    );
    if (other && type === other.type) {
      throw new Error(`an element of it is in ${other.name}, too; take it out of one of them`);
    }
  } else if (type === "point_mass") {
    if (!(entry.nodes ?? []).length) {
      throw new Error("name its nodes, as in 2, 3");
    }
    for (const label of entry.nodes) {
      if (!model.nodes.has(label)) {
        throw new Error(`there is no node ${label}`);
      }
    }
  } else {
    if (!(entry.first ?? []).length) {
      throw new Error("name where it begins: node and direction, as in 2X");
    }
    if (entry.second !== undefined && listed(entry.second).length !== listed(entry.first).length) {
      throw new Error("name as many ends as beginnings, or none: then it goes to the ground");
    }
    for (const text of [...listed(entry.first), ...listed(entry.second)]) {
      const dof = parseDofs(String(text));
      if (!dof || dof.directions.length !== 1) {
        throw new Error(`${text} is no place; write node and direction, as in 2X`);
      }
      if (!model.nodes.has(dof.node)) {
        throw new Error(`there is no node ${dof.node}`);
      }
    }
  }
}

const unknownsOf = (model, name) =>
  model.unknown.flatMap((one, k) =>
    listed(one.elements).some((text) => String(text).split(":")[0] === name) ? [k] : [],
  );

function renamed(model, set, name) {
  if (!name) {
    throw new Error("give it a name");
  }
  if (name !== set.name && model.sets.some((one) => one.name === name)) {
    throw new Error(`there is a set ${name} already`);
  }
  const follow = unknownsOf(model, set.name).map((k) => {
    const elements = listed(model.unknown[k].elements).map((text) =>
      [name, ...String(text).split(":").slice(1)].join(":"),
    );
    const changed = listed(model.unknown[k].elements).map((text, i) =>
      String(text).split(":")[0] === set.name ? elements[i] : text,
    );
    return {
      set: ["unknown", k, "elements"],
      to: Array.isArray(model.unknown[k].elements) ? texts(changed) : JSON.stringify(changed[0]),
    };
  });
  return {
    words: `${set.name} is ${name} now`,
    edits: [{set: [...set.path, "name"], to: JSON.stringify(name)}, ...follow],
  };
}

// What hangs on a node, in words; empty where it can go by itself.
export function dependentsOf(model, label) {
  const words = [];
  for (const set of model.sets) {
    const pairs = pairsOf(set).filter((pair) => pair.includes(label));
    if (pairs.length) {
      words.push(
        `${pairs.length === 1 ? "element" : "elements"} ${pairs.map((pair) => pair.join("-")).join(", ")} of ${set.name}`,
      );
    }
    if (set.type === "point_mass" && set.entry.nodes?.includes(label)) {
      words.push(`the mass of ${set.name}`);
    }
    if (
      set.type === "spring" &&
      springEnds(set)
        .flat()
        .some((text) => text !== null && parseDofs(text)?.node === label)
    ) {
      words.push(`a spring of ${set.name}`);
    }
  }
  if (model.fixed.some((one) => one.node === label)) {
    words.push("its support");
  }
  for (const text of model.sensors) {
    if (parseDofs(text)?.node === label) {
      words.push(`the sensor ${text}`);
    }
  }
  for (const text of model.loads) {
    if (parseDofs(text)?.node === label) {
      words.push(`the load ${text}`);
    }
  }
  return words;
}

// A doubtful thing that prevents the study from being read; it has no place in the picture.
const grave = (words, nodes = []) => ({words, nodes, outlines: [], isGrave: true});

// What is doubtful: words, the nodes and elements that they are about, and whether the study cannot be read so.
export function findings(model) {
  const size = sizeOf(model);
  return [
    ...coincidentNodes(model, size),
    ...model.sets.flatMap((set) => doubtsOfSet(model, set, size)),
    ...missingNodes(model),
    ...looseNodes(model),
  ];
}

// Pairs of nodes at one place, by X first so that few pairs are compared.
function coincidentNodes(model, size) {
  const list = [],
    labelsOf = [...model.nodes.keys()].sort((a, b) => model.nodes.get(a)[0] - model.nodes.get(b)[0]);
  labelsOf.forEach((label, k) => {
    const first = model.nodes.get(label);
    for (let j = k + 1; j < labelsOf.length; j += 1) {
      const second = model.nodes.get(labelsOf[j]);
      if (!(second[0] - first[0] <= 1e-9 * size)) {
        break;
      }
      if (same(first, second, size)) {
        const pair = [label, labelsOf[j]].sort((a, b) => a - b);
        list.push({
          words: `Nodes ${pair[0]} and ${pair[1]} are at the same place. Nothing joins them unless an element does: move one, or remove it.`,
          nodes: pair,
          outlines: [],
        });
      }
    }
  });
  return list;
}

// Nodes that the elements of a set name, in the order of the elements.
const nodesOfSet = (set) =>
  set.type === "spring"
    ? springEnds(set)
        .flat()
        .filter((text) => text !== null)
        .map((text) => parseDofs(text)?.node)
    : (set.entry.nodes ?? []).flat();

// Elements at nodes that are not there, and elements without length.
function doubtsOfSet(model, set, size) {
  const isPoint = (pair) => {
    const [a, b] = pair.map((label) => model.nodes.get(label));
    return a && b && same(a, b, size);
  };
  return [
    ...nodesOfSet(set)
      .filter((label) => !model.nodes.has(label))
      .map((label) => grave(`${set.name} names node ${label}, which is not there.`)),
    ...pairsOf(set)
      .filter(isPoint)
      .map((pair) => grave(`Element ${pair.join("-")} of ${set.name} has no length.`, pair)),
  ];
}

// Supports, planned sensors and loads, and sensors of a record on nodes that are not there.
function missingNodes(model) {
  const planned = (what, texts_) =>
    texts_
      .filter((text) => !model.nodes.has(parseDofs(text)?.node))
      .map((text) =>
        grave(`The ${what} ${text} is on a node that is not there: put the node back (Undo), or take the ${what} out.`),
      );
  return [
    ...model.fixed
      .filter((one) => one.node !== null && !model.nodes.has(one.node))
      .map((one) => grave(`The support ${one.text} is at node ${one.node}, which is not there.`)),
    ...planned("sensor", model.sensors),
    ...planned("load", model.loads),
    ...model.placed.flatMap((record) =>
      Object.entries(record)
        .filter(([, one]) => one?.node !== undefined && !model.nodes.has(one.node))
        .map(([name, one]) =>
          grave(
            `The sensor ${name} of the record is on node ${one.node}, which is not there: put the node back (Undo), or place the sensor anew in step Structure.`,
          ),
        ),
    ),
  ];
}

// Nodes of no element, in one finding; none where elements may come from elsewhere.
function looseNodes(model) {
  const used = new Set(model.sets.flatMap(nodesOfSet)),
    loose =
      model.others.length || !model.sets.length ? [] : [...model.nodes.keys()].filter((label) => !used.has(label));
  return loose.length
    ? [
        {
          words: `${loose.length === 1 ? `Node ${loose[0]} belongs` : `Nodes ${loose.slice(0, 12).join(", ")} belong`} to no element yet.`,
          nodes: loose,
          outlines: [],
        },
      ]
    : [];
}
