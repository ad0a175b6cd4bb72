class_name TouchfieldPlayer
extends RefCounted
## Plays a .touch file: proxy at walls, friction, damping, limits of the force and ramp.
##
## Positions are metres and forces newtons, in the axes of the medium. A thread of the player's own decodes ahead.
## One thread calls [method tick] or [method advance], which do not wait; one thread gives the orders [method play],
## [method pause], [method seek] and [method stop]. Call [method close] at the end.

## Options of [method open], besides the numbers: they are given as true or false.
const FLAGS := ["is_loop", "is_complete", "is_passive"]

var axes := "" ## of the medium, such as "x right, y down, z forward"
var duration_s := 0.0 ## of the medium
var force_max_n := 0.0 ## greatest force that the medium allows

var _receiver := TouchfieldReceiver.new()
var _decoder := Thread.new()
var _is_closing := [false] # shared with the thread, which may not hold the player
var _rate_hz := 1000.0
var _clock_s := 0.0
var _position_m := Vector3.ZERO
var _has_position := false


## Opens a file, with options of [code]touchfield.h[/code] such as [code]{"force_max_n": 3.3, "is_loop": true}[/code].
## Returns "", or why the file cannot be played.
func open(path: String, options := {}) -> String:
	var bytes := FileAccess.get_file_as_bytes(path)
	if bytes.is_empty():
		return "%s: the file cannot be read, or is empty (%s)" % [path, error_string(FileAccess.get_open_error())]
	return open_bytes(bytes, path, options)


## Opens the bytes of a file; the name is for messages.
func open_bytes(bytes: PackedByteArray, name: String, options := {}) -> String:
	if _decoder.is_started() or not _receiver.open(bytes):
		return "%s: the player is open, or there is no memory" % name
	for option: String in options:
		var value: Variant = options[option]
		if not (typeof(value) in [TYPE_FLOAT, TYPE_INT, TYPE_BOOL] and _receiver.set_option(option, float(value))):
			return "%s: there is no option %s of the value %s" % [name, option, value]
	if not _receiver.start():
		return "%s: %s" % [name, _receiver.get_error()]
	_rate_hz = options.get("rate_hz", 1000.0)
	axes = _receiver.get_axes()
	duration_s = _receiver.get_duration_s()
	force_max_n = _receiver.get_force_max_n()
	_decoder.start(_decode_ahead.bind(_receiver, _is_closing))
	return ""


## The force on a hand at a position, by a clock in seconds that does not go back.
func tick(position_m: Vector3, clock_s := 1e-6 * Time.get_ticks_usec()) -> Vector3:
	return _receiver.tick(position_m, clock_s)


## Whether a tick at that time finds its frames decoded: for simulations, which may wait.
func is_ready(clock_s: float) -> bool:
	return _receiver.is_ready(clock_s)


## The force after some seconds in which the hand moves straight to a position: ticks of simulated time at the rate of
## the player. For loops that are slower than a device's, such as [code]_physics_process[/code].
func advance(position_m: Vector3, seconds: float) -> Vector3:
	var start_m := _position_m if _has_position else position_m
	var ticks := maxi(1, roundi(seconds * _rate_hz))
	var force_n := Vector3.ZERO
	for n in range(1, ticks + 1):
		var fraction := n / float(ticks)
		force_n = tick(start_m.lerp(position_m, fraction), _clock_s + fraction * seconds)
	_position_m = position_m
	_has_position = true
	_clock_s += seconds
	return force_n


func play() -> void:
	_receiver.resume()


## The medium stands, and its force stays.
func pause() -> void:
	_receiver.pause()


## Goes on at a time of the medium.
func seek(time_s: float) -> void:
	_receiver.seek(time_s)


## Brings the force to zero for ever, within the ramp: tick until [method is_released].
func stop() -> void:
	_receiver.stop()


func is_released() -> bool:
	return _receiver.is_released()


## Whether the medium has ended and the force is zero.
func is_over() -> bool:
	return _receiver.is_over()


## Time of the medium at the latest tick.
func get_time_s() -> float:
	return _receiver.get_media_s()


## Why it plays no longer, or that the thread that decodes hangs; or "". Then the force goes to zero.
func get_error() -> String:
	return _receiver.get_error()


## Ends the thread that decodes. The force does not ramp: call [method stop] before.
func close() -> void:
	_is_closing[0] = true
	if _decoder.is_started():
		_decoder.wait_to_finish()


func _notification(what: int) -> void:
	if what == NOTIFICATION_PREDELETE: # methods cannot be called any more
		_is_closing[0] = true
		if _decoder.is_started():
			_decoder.wait_to_finish()


static func _decode_ahead(receiver: TouchfieldReceiver, is_closing: Array) -> void:
	while not is_closing[0]:
		if not receiver.decode():
			OS.delay_msec(1)
