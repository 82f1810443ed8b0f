// A Run button on each Python program of a page. Programs can be changed before they run.
// A browser starts workers only from a server, so pages that are opened as files have no buttons.
const live = new URL(".", document.currentScript.src);
let worker = null;
let waiting = new Map(); // number of a run -> the function that takes its messages
let count = 0;

function start() {
  worker = new Worker(new URL("worker.js", live), { type: "module" });
  worker.onmessage = ({ data }) => waiting.get(data.run)?.(data);
  worker.onerror = (event) => {
    for (const take of waiting.values()) take({ done: `Python did not start: ${event.message}` });
  };
}

function addButton(block, programs, index, figures) {
  const button = Object.assign(document.createElement("button"), { className: "live-run", textContent: "Run" });
  const output = Object.assign(document.createElement("div"), { className: "live-output", hidden: true });
  const text = output.appendChild(document.createElement("pre"));
  const status = output.appendChild(document.createElement("p"));
  status.setAttribute("role", "status");
  block.querySelector("pre").contentEditable = "plaintext-only";
  block.after(button, output);
  button.onclick = () => {
    if (!worker) start();
    const run = ++count;
    button.disabled = true;
    output.hidden = false;
    text.textContent = "";
    output.querySelectorAll("img").forEach((image) => image.remove());
    status.textContent = "Starting Python …";
    waiting.set(run, (message) => {
      if (message.print !== undefined) text.textContent += message.print + "\n";
      if (message.status) status.textContent = message.status;
      if (message.picture) {
        const image = Object.assign(document.createElement("img"), { alt: message.name });
        image.src = URL.createObjectURL(new Blob([message.picture], { type: message.type }));
        status.before(image);
      }
      if (message.done) {
        status.textContent = message.done;
        button.disabled = false;
        waiting.delete(run);
      }
    });
    // A program may use names of the programs above it.
    const code = programs.slice(0, index + 1).map((one) => one.querySelector("pre").innerText);
    worker.postMessage({ run, code, figures: figures.length > 0 });
  };
}

document.addEventListener("DOMContentLoaded", async () => {
  if (location.protocol === "file:") return;
  const settings = await (await fetch(new URL("settings.json", live))).json();
  const page = location.pathname.replace(/\.html$/, "");
  if (settings.without.some((name) => page.endsWith(`/${name}`))) return;
  if (page.includes("/notebooks/")) return;
  const programs = [...document.querySelectorAll("article div.highlight-python")];
  programs.forEach((block, index) => addButton(block, programs, index, settings.figures));
});
