// The clock of the page: the instant that is shown, and how fast the medium's time passes.
import { byId, input, setText } from "../elements";
import type { Medium } from "./medium";

/** Seconds of the medium. */
export let time = 0;
export let isPlaying = false;
/** The fraction of the chosen speed that decoding keeps up with. */
export let pace = 1;

export const setTime = (seconds: number): void => void (time = seconds);
export const setPlaying = (on: boolean): void => void (isPlaying = on);
export const setPace = (fraction: number): void => void (pace = fraction);

/** Seconds of the medium in a second, as the user chose. */
export const chosenSpeed = (): number => Number(byId<HTMLSelectElement>("speed").value);
/** The same as it is reached when the medium plays. */
export const speed = (): number => chosenSpeed() * pace;
/** The same at this moment; 0 in a pause. */
export const currentSpeed = (): number => (isPlaying ? speed() : 0);

export function chooseSpeed(speed: number): void {
  byId<HTMLSelectElement>("speed").value = String(speed);
}

/** A short medium plays slowly, so that it can be followed. */
export function start({ head, seconds }: Medium): void {
  byId("time").hidden = head.frames < 2;
  const whole = head.frames / head.rate;
  chooseSpeed(whole < 0.1 ? 0.01 : whole < 0.6 ? 0.1 : 1);
  input("at").max = String(seconds);
}

export function show({ head, seconds }: Medium): void {
  input("at").value = String(time);
  const digits = seconds < 0.5 ? 4 : 2;
  const text = `${time.toFixed(digits)} of ${seconds.toFixed(digits)} s, frame ${Math.floor(time * head.rate + 1e-6)} of ${head.frames - 1}`;
  setText("clock", text);
  byId("at").setAttribute("aria-valuetext", text);
}
