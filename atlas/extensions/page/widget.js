// The page in a frame of its own, which can reach neither the notebook around it nor the network; its clicks arrive as messages.

function render({ model, el }) {
  const frame = document.createElement("iframe");
  frame.title = "atlas";
  frame.sandbox = "allow-scripts allow-downloads";
  frame.style = `border: 0; width: 100%; height: ${model.get("height")}px`;
  frame.srcdoc = model.get("html");
  const listen = ({ source, data }) => {
    if (source !== frame.contentWindow || !data.point) return;
    model.set("point", data.point);
    model.save_changes();
  };
  addEventListener("message", listen);
  el.append(frame);
  return () => removeEventListener("message", listen);
}

export default { render };
