// Python in a worker, so that the page stays responsive. All files come from this folder.
import { loadPyodide } from "./pyodide.mjs";

const live = new URL(".", import.meta.url);
const VERSIONS = `
import sys, numpy, scipy, celnav
f"Python {sys.version.split()[0]}, numpy {numpy.__version__}, scipy {scipy.__version__}, celnav {celnav.__version__}"
`;
const PICTURES = { svg: "image/svg+xml", png: "image/png" };
let settings;
let versions;
let ready = null;
let queue = Promise.resolve();

async function load(say) {
  settings = await (await fetch(new URL("settings.json", live))).json();
  const python = await loadPyodide({ indexURL: live.href });
  say("Loading numpy and scipy …");
  const quiet = { messageCallback() {} };
  await python.loadPackage(settings.libraries, quiet);
  await python.loadPackage(new URL(settings.wheel, live).href, quiet);
  versions = python.runPython(VERSIONS);
  return python;
}

async function run({ run, code, figures }) {
  const post = (message) => postMessage({ run, ...message });
  try {
    ready ??= load((status) => post({ status }));
    const python = await ready;
    if (figures && code.some((program) => program.includes(".savefig("))) {
      post({ status: "Loading matplotlib …" });
      await python.loadPackage(settings.figures, { messageCallback() {} });
      // Its font cache is built when this module is imported, with a message that is not the program's.
      python.setStderr({ batched() {} });
      python.runPython("import matplotlib.font_manager; matplotlib.use('agg')");
    }
    const folder = `/home/pyodide/run${run}`;
    python.FS.mkdir(folder);
    python.FS.chdir(folder);
    post({ status: "Running …" });
    const names = python.toPy({ __name__: "__main__" });
    const started = performance.now();
    try {
      for (const [index, program] of code.entries()) {
        const last = index === code.length - 1;
        python.setStdout({ batched: (text) => last && post({ print: text }) });
        python.setStderr({ batched: (text) => last && post({ print: text }) });
        await python.runPythonAsync(program, { globals: names });
      }
    } finally {
      names.destroy();
    }
    const seconds = ((performance.now() - started) / 1000).toFixed(1);
    for (const name of python.FS.readdir(folder)) {
      const type = PICTURES[name.split(".").pop()];
      if (type) post({ picture: python.FS.readFile(`${folder}/${name}`), name, type });
    }
    post({ done: `Ran in ${seconds} s. ${versions}` });
  } catch (error) {
    post({ print: error.message });
    post({ done: "The program did not run to its end." });
  }
}

onmessage = ({ data }) => {
  queue = queue.then(() => run(data));
};
