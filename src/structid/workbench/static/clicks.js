// A click counts where it was begun: what a field tells once it is left, or a change of the file, may move or replace what is under the pointer.
const NEAR = 4, // px
  LONGEST = 3000; // ms
let isDown = false,
  pressed = null;

// Done once no button of the pointer is down and its click has been heard; it may have been let go outside the window.
export const pointerUp = () =>
  new Promise((done) => {
    const begun = performance.now(),
      look = () => (isDown && performance.now() - begun < LONGEST ? setTimeout(look, 50) : done());
    setTimeout(look);
  });

export function keepClicks() {
  for (const name of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
    window.addEventListener(
      name,
      (event) => {
        isDown = event.buttons !== 0;
      },
      true,
    );
  }
  window.addEventListener(
    "mousedown",
    ({target, button, clientX, clientY}) => {
      const control = button === 0 ? target.closest("button, a, summary, label") : null;
      pressed = control && {control, clientX, clientY};
    },
    true,
  );
  window.addEventListener(
    "mouseup",
    ({target, clientX, clientY}) => {
      const begun = pressed;
      pressed = null;
      if (
        begun?.control.isConnected &&
        !begun.control.contains(target) &&
        Math.hypot(clientX - begun.clientX, clientY - begun.clientY) < NEAR
      ) {
        begun.control.click(); // it moved away, not the pointer
      }
    },
    true,
  );
}
