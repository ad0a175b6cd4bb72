extends SceneTree
# Calls of the extension that a script of Godot can make: prints "ok", or what is not so.

var failures := 0


func check(is_right: bool, what: String) -> void:
	if not is_right:
		failures += 1
		print("not so: ", what)


func _initialize() -> void:
	var bytes := FileAccess.get_file_as_bytes(OS.get_cmdline_user_args()[0])
	check_before_open()
	check_typed(bytes)
	check_untyped(bytes)
	check_player(bytes)
	if not failures:
		print("ok")
	quit(failures)


func check_before_open() -> void:
	var receiver := TouchfieldReceiver.new()
	check(not receiver.start() and not receiver.decode() and not receiver.is_ready(0.0), "false before open")
	check(receiver.tick(Vector3.ONE, 0.0) == Vector3.ZERO, "no force before open")
	check(receiver.get_error() == "" and receiver.get_axes() == "", "no text before open")
	check(receiver.get_duration_s() == 0.0 and not receiver.set_option("speed", 1.0), "no option before open")
	receiver.resume()
	receiver.pause()
	receiver.seek(1.0)
	receiver.stop()
	check(receiver.open(PackedByteArray()) and not receiver.start(), "an empty file does not start")
	check(receiver.get_error() != "", "why an empty file does not start")


func check_typed(bytes: PackedByteArray) -> void:
	var receiver := TouchfieldReceiver.new()
	check(receiver.open(bytes) and not receiver.open(bytes), "a receiver opens once")
	check(receiver.set_option("speed", 2.0), "an option")
	check(not receiver.set_option("x".repeat(63), 1.0) and not receiver.set_option("é".repeat(500), 1.0), "long names")
	check(not receiver.set_option("", 1.0) and not receiver.set_option("speed", NAN), "no name, no number")
	check(receiver.start() and not receiver.start(), "a receiver starts once")
	check(receiver.get_axes().begins_with("x ") and receiver.get_duration_s() > 0.0, "the head")
	check(not receiver.is_over() and not receiver.is_released(), "it plays")


func check_untyped(bytes: PackedByteArray) -> void:
	var receiver: Variant = ClassDB.instantiate("TouchfieldReceiver")
	check(receiver.callv("open", [bytes]) == true, "open by name")
	check(receiver.callv("set_option", ["speed", 1]) == true, "an integer is a number")
	check(receiver.callv("start", []) == true, "start by name")
	check(receiver.callv("tick", [Vector3.ZERO, 0]) is Vector3, "tick by name")
	check(receiver.callv("get_axes", []) == receiver.get_axes(), "a text by name")
	check(receiver.callv("tick", ["here", 0.0]) == null, "a text is no position")
	check(receiver.callv("tick", [Vector3.ZERO]) == null, "a missing argument")
	check(receiver.callv("tick", [Vector3.ZERO, 0.0, 1.0]) == null, "an argument too many")


func check_player(bytes: PackedByteArray) -> void:
	for n in 50: # some are closed, and the others are dropped with their threads
		var player := TouchfieldPlayer.new()
		check(player.open_bytes(bytes, "bytes", {"is_loop": true, "max": 1}) != "", "an option that is none")
		player = TouchfieldPlayer.new()
		check(player.open_bytes(bytes, "bytes", {"is_loop": true, "force_max_n": 1}) == "", "the player opens")
		check(player.open_bytes(bytes, "bytes") != "", "the player opens once")
		if n % 2:
			player.close()
