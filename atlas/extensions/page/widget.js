// The page in a frame of its own, which can reach neither the notebook around it nor the network; its clicks arrive as messages.

function render({ model, el }) {
  el.innerHTML = model.get("frame");
  const frame = el.querySelector("iframe");
  const listen = ({ source, data }) => {
    if (source !== frame.contentWindow || !data.point) return;
    model.set("point", data.point);
    model.save_changes();
  };
  addEventListener("message", listen);
  return () => removeEventListener("message", listen);
}

export default { render };
