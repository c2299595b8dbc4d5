// One line on what comes next in *Build*, and whether the study can be read as it stands.
import {get} from "../api.js";
import {fill} from "../dom.js";

// A function that tells the line in `state`: what comes next at once, whether the study can be read a moment after the last edit.
export function readableLine({app, editor}, state) {
  let timer = 0;
  return () => {
    clearTimeout(timer);
    const words = nextWords(editor);
    if (words) {
      fill(state, words);
      return;
    }
    timer = setTimeout(async () => {
      const {digest} = app.now,
        read = await readWords(app.study, editor.model);
      if (app.now?.digest === digest) {
        fill(state, read);
      }
    }, 500);
  };
}

function nextWords({count, model}) {
  if (count) {
    return "Saving…";
  }
  if (!model.nodes.size) {
    return "Begin with the nodes: type a coordinate, Tab, and Enter at the end of the row.";
  }
  if (!model.sets.length && !model.others.length) {
    return "Saved. Now join the nodes: name some beams, write their elements as in 1-2, and give their values.";
  }
  return "";
}

async function readWords(study, model) {
  try {
    await get("line", {study});
    return "Saved. The study can be read; step Structure shows what it can determine.";
  } catch (error) {
    return model.unknown.length
      ? `Saved. It cannot be used yet: ${error.message}`
      : "Saved. The next thing to say is what you look for: step Unknowns.";
  }
}
