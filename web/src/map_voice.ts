// What the page of maps says and lets feel: a region that screen readers read, the browser's own speech, and for each class a
// short tone and a short vibration.
import { classOf } from "./map_classes";
import { currentLanguage } from "./map_text";
import { Sound } from "./sound";
import { say } from "./speech";

const QUIET_MS = 120; // in which a later sentence takes the place of one
const PULSE_MS = 160;
const LOUDNESS: Record<string, number> = { point: 1, line: 0.6, label: 0.45, area: 0.25 };

export class Voice {
  private readonly output = new Sound();
  private timer = 0;
  private pulse = 0;
  private isSpeaking = false;
  /** All sentences, for tests. */
  readonly sentences: string[] = [];

  get hasSpeech(): boolean {
    return "speechSynthesis" in window;
  }

  get isSpoken(): boolean {
    return this.isSpeaking;
  }

  get isSounding(): boolean {
    return this.output.isOn;
  }

  get isVibrating(): boolean {
    return this.output.isRumbling;
  }

  /** Say a sentence; of several that follow each other quickly, the last. */
  announce(sentence: string): void {
    window.clearTimeout(this.timer);
    this.timer = window.setTimeout(() => this.sayNow(sentence), QUIET_MS);
  }

  sayNow(sentence: string): void {
    window.clearTimeout(this.timer);
    if (!sentence) return;
    say(sentence);
    this.sentences.push(sentence);
    this.speak(sentence);
  }

  /** Speak without the region. */
  speak(sentence: string): void {
    if (!this.isSpeaking || !this.hasSpeech) return;
    speechSynthesis.cancel();
    const utterance = new SpeechSynthesisUtterance(sentence);
    utterance.lang = currentLanguage();
    speechSynthesis.speak(utterance);
  }

  setSpeech(on: boolean): void {
    this.isSpeaking = on;
    if (!on && this.hasSpeech) speechSynthesis.cancel();
  }

  setSound(on: boolean): Promise<void> {
    return this.output.sound(on);
  }

  setVibration(on: boolean): void {
    this.output.rumble(on);
  }

  /** A short tone and vibration of a class. */
  touch(kind: string, role: string): void {
    window.clearTimeout(this.pulse);
    this.output.play(LOUDNESS[role] ?? 0.5, 0, 0, classOf(kind).hertz);
    this.pulse = window.setTimeout(() => this.output.play(0, 0, 0, 0), PULSE_MS);
  }
}
