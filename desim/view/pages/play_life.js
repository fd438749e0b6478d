// The one connection that all pages of a session share: as long as it is open, the server runs. A browser opens only six
// connections to a host, so if each page had its own, the seventh page would wait for ever.

const pages = [];
const life = new EventSource("alive");
life.onerror = () => { life.close(); pages.forEach(page => page.postMessage("ended")); };
onconnect = ({ ports: [page] }) => {
  pages.push(page);
  if (life.readyState === EventSource.CLOSED) page.postMessage("ended");
};
