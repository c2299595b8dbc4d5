// Questions to the server; the token is part of the page's own address.
const BASE = new URL(".", location.href);

export class Refused extends Error {
  constructor(words, status) { super(words); this.status = status; }
}

async function answered(response) {
  const text = await response.text().catch(() => "");
  let found = null;
  try { found = JSON.parse(text); } catch { found = {error: text}; }
  if (!response.ok) { throw new Refused(found.error || `the server answered ${response.status}`, response.status); }
  return found;
}

async function asked(path, settings) {
  try { return await fetch(new URL(path, BASE), settings); }
  catch { throw new Refused("the workbench does not answer: it was ended, or this page is too old; start `structid app` again. Runs go on without it", 0); }
}

export async function get(path, given = {}) {
  return answered(await asked(`api/${path}?${new URLSearchParams(given)}`));
}

export async function post(path, body) {
  return answered(await asked(`api/${path}`, {method: "POST", headers: {"content-type": "application/json"}, body: JSON.stringify(body)}));
}

export async function put(name, file, replace = "") {
  return answered(await asked(`api/file?${new URLSearchParams({name, replace})}`, {method: "PUT", headers: {"content-type": "application/octet-stream"}, body: file}));
}

export const link = (path, given) => new URL(`api/${path}?${new URLSearchParams(given)}`, BASE).href;
export const view = (path) => new URL(path, BASE.origin).href;

// `lost` hears true where the server is away, and false when it is there again.
export function events(heard, lost) {
  const source = new EventSource(new URL("api/events", BASE));
  source.onmessage = (message) => heard(JSON.parse(message.data));
  source.onerror = () => lost(true);
  source.onopen = () => lost(false);
}
