extends SceneTree
## Runs the extension without a window:
##
## [codeblock]
## godot --headless --path build -s try_touchfield.gd -- [NAME=VALUE ...] FILE.touch HAND.txt FORCES.txt
## [/codeblock]
##
## HAND.txt has a line `x y z`, metres, for each tick of 1 ms; FORCES.txt gets the force of each, newtons, and those on
## the way to zero. Time is simulated. A NAME is an option of the player, or [code]steps=1[/code]: a line is then a step
## of the physics, in which the node [Touchfield] ticks, and the hand is given in the axes of the world.


func _initialize() -> void:
	var words := OS.get_cmdline_user_args()
	var options := {}
	while words.size() > 3 and "=" in words[0]:
		options[words[0].get_slice("=", 0)] = words[0].get_slice("=", 1).to_float()
		words.remove_at(0)
	if words.size() != 3:
		printerr("try_touchfield.gd: [NAME=VALUE ...] FILE.touch HAND.txt FORCES.txt")
		quit(64)
		return
	var is_stepped: bool = options.get("steps", 0.0) != 0.0
	options.erase("steps")
	var positions_m := _read_positions(words[1])
	if is_stepped:
		var forces_n := await _run_steps(words[0], positions_m, options)
		if forces_n:
			_write(words[2], forces_n)
	else:
		_run_ticks(words, positions_m, options)


func _run_ticks(words: PackedStringArray, positions_m: PackedVector3Array, options: Dictionary) -> void:
	var player := TouchfieldPlayer.new()
	var error := player.open(words[0], {"is_complete": true}.merged(options))
	if error:
		printerr(error)
		quit(65)
		return
	var forces_n := PackedVector3Array()
	player.play()
	while not player.is_released():
		var n := forces_n.size()
		if n == positions_m.size():
			player.stop()
		while not player.is_ready(1e-3 * n):
			OS.delay_usec(100)
		forces_n.push_back(player.tick(positions_m[mini(n, positions_m.size() - 1)], 1e-3 * n))
	player.close()
	_write(words[2], forces_n)


func _run_steps(path: String, positions_m: PackedVector3Array, options: Dictionary) -> PackedVector3Array:
	await process_frame # nodes become ready once the tree runs
	var node := Touchfield.new()
	node.file = path
	node.options = options
	node.hand = Node3D.new()
	root.add_child(node.hand)
	node.hand.position = positions_m[0]
	root.add_child(node)
	if not node.player:
		quit(65)
		return PackedVector3Array()
	while not node.player.is_ready(0.0):
		OS.delay_msec(1)
	var forces_n := PackedVector3Array()
	for position_m in positions_m:
		await physics_frame # before the step
		forces_n.push_back(node.force_n)
		node.hand.position = position_m
	await physics_frame
	forces_n.push_back(node.force_n)
	return forces_n.slice(1)


func _read_positions(path: String) -> PackedVector3Array:
	var positions_m := PackedVector3Array()
	for line in FileAccess.get_file_as_string(path).split("\n", false):
		var numbers := line.split_floats(" ")
		positions_m.push_back(Vector3(numbers[0], numbers[1], numbers[2]))
	return positions_m


func _write(path: String, forces_n: PackedVector3Array) -> void:
	var out := FileAccess.open(path, FileAccess.WRITE)
	for force_n in forces_n:
		out.store_line("%.12f %.12f %.12f" % [force_n.x, force_n.y, force_n.z])
	out.close()
	quit()
