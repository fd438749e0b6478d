// Python in a worker of the browser, with desim: it answers the changes of an example that the front page asks for.
const PACKAGES = ["cloudpickle", "jinja2", "networkx", "numpy", "pydantic", "tomli-w"];
let ready = null;

async function begin({ pyodide, archive }) {
  const tell = text => postMessage({ status: text });
  tell("Python is loading ...");
  const { loadPyodide } = await import(`${pyodide}pyodide.mjs`);
  const [python, response] = await Promise.all([loadPyodide({ indexURL: pyodide }), fetch(archive)]);
  if (!response.ok) throw new Error(`${archive}: ${response.status}`);
  await python.loadPackage(PACKAGES, { messageCallback: () => {}, errorCallback: tell });
  tell("desim is loading ...");
  python.unpackArchive(await response.arrayBuffer(), "zip", { extractDir: "/desim" });
  python.runPython("import sys; sys.path.insert(0, '/desim')");
  return python.pyimport("desim.view.pages.in_browser").answer_as_json;
}

onmessage = async ({ data }) => {
  try {
    ready ??= begin(data);
    const answer = await ready;
    postMessage({ number: data.number, answer: JSON.parse(answer(data.name, data.changes)) });
  } catch (error) {
    postMessage({ number: data.number, failed: `${error.message ?? error}`.trim().split("\n").at(-1) });
  }
};
