// Python in a worker of the browser, with desim: it answers the changes of an example that the front page asks for.
const PACKAGES = ["cloudpickle", "jinja2", "numpy", "pydantic", "tomli-w"];
// Given by its address, a package is loaded without what it depends on: for networkx that is matplotlib, which no run needs.
const ALONE = ["networkx"];
let ready = null;

async function begin({ pyodide, archive }) {
  const tell = text => postMessage({ status: text });
  tell("Python is loading ...");
  const { loadPyodide } = await import(`${pyodide}pyodide.mjs`);
  const [python, response] = await Promise.all([loadPyodide({ indexURL: pyodide }), fetch(archive)]);
  if (!response.ok) throw new Error(`${archive}: ${response.status}`);
  const addresses = ALONE.map(name => new URL(pyodide + python.lockfile.packages[name].file_name, location).href);
  await python.loadPackage([...PACKAGES, ...addresses], { messageCallback: () => {}, errorCallback: tell });
  tell("desim is loading ...");
  python.unpackArchive(await response.arrayBuffer(), "zip", { extractDir: "/desim" });
  python.runPython("import sys; sys.path.insert(0, '/desim')");
  return python.pyimport("desim.view.pages.in_browser").answer_as_json;
}

// The last line with the name of an exception: Pyodide appends advice to some.
function reason(error) {
  const lines = `${error.message ?? error}`.trim().split("\n");
  return (lines.findLast(line => /^[A-Za-z_][\w.]*(Error|Exception): /.test(line)) ?? lines.at(-1)).replace(/\.$/, "");
}

onmessage = async ({ data }) => {
  try {
    ready ??= begin(data);
    const answer = await ready;
    postMessage({ number: data.number, answer: JSON.parse(answer(data.name, data.changes)) });
  } catch (error) {
    postMessage({ number: data.number, failed: reason(error) });
  }
};
