// Records what a page sends to a game pad and a phone, and the pictures of its movie, on one clock; `timelineCalls` at the end.
(() => {
  const [calls, pictures] = [[], []];
  const video = document.getElementById("video");
  const record = (kind, level) => void calls.push({ kind, level, at: performance.now(), time: video.currentTime });
  const actuator = {
    effects: ["dual-rumble"],
    playEffect: (_, effect) => Promise.resolve(record("pad", [effect.strongMagnitude, effect.weakMagnitude])),
    reset: () => Promise.resolve(record("pad", [0, 0])),
  };
  const pad = { id: "recorder", axes: [], buttons: [], vibrationActuator: actuator };
  Object.defineProperty(navigator, "getGamepads", { value: () => [pad] });
  Object.defineProperty(navigator, "vibrate", { value: (pattern) => (record("phone", pattern), true) });
  // the picture that is on the screen from a time on
  const see = (_, { mediaTime, expectedDisplayTime }) => {
    pictures.push([expectedDisplayTime, mediaTime]);
    video.requestVideoFrameCallback(see);
  };
  video.requestVideoFrameCallback(see);
  window.timelineCalls = { calls, pictures };
})();
