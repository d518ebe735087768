// The canvas of the studio in a notebook: its page in a frame, and the messages between it and the kernel.
const PAGE = "PAGE"; // the widget writes the page here
function render({ model, el }) {
  const view = Math.random().toString(36).slice(2);
  const frame = document.createElement("iframe");
  const dark = document.body?.dataset.jpThemeLight === "false" || document.body?.classList.contains("vscode-dark");
  frame.title = "optlink studio";
  frame.style.cssText = "display:block;width:100%;border:1px solid rgba(128,128,128,.4);border-radius:6px;box-sizing:border-box";
  frame.style.height = model.get("height") + "px";
  frame.allow = "clipboard-write";
  const tell = (message) => frame.contentWindow?.postMessage(message, "*");
  const answered = (message) => tell(message.view === view ? { studio: "answer", text: message.text } : { studio: "close" });
  const asked = ({ source, data }) => {
    if (source === frame.contentWindow && data?.studio) {
      model.send({ view, text: data.studio === "connect" ? null : data.text });
    }
  };
  const ended = () => model.comm_live === false && tell({ studio: "close" });
  addEventListener("message", asked);
  model.on("msg:custom", answered);
  model.on("comm_live_update", ended);
  frame.srcdoc = PAGE.replace("<html ", `<html data-prefer="${dark ? "dark" : "light"}" `);
  el.append(frame);
  return () => {
    removeEventListener("message", asked);
    model.off("msg:custom", answered);
    model.off("comm_live_update", ended);
  };
}
export default { render };
