class_name Touchfield
extends Node3D
## Plays a .touch file at the place of this node; [member force_n] is the force on [member hand].
##
## For a hand that is shown or simulated. For a device, call [method TouchfieldPlayer.tick] in a thread, 1000 times a
## second. A unit of the world is a metre.

@export_file("*.touch") var file := ""
@export var hand: Node3D
@export var is_loop := true
## Options of [method TouchfieldPlayer.open].
@export var options := {}
@export_group("Axes")
## Where the x of the medium points in this node; see [member TouchfieldPlayer.axes].
@export var x := Vector3.RIGHT
@export var y := Vector3.DOWN
@export var z := Vector3.FORWARD

var player: TouchfieldPlayer
var force_n := Vector3.ZERO ## in the axes of the world


func _ready() -> void:
	player = TouchfieldPlayer.new()
	var error := player.open(file, {"is_loop": is_loop}.merged(options, true))
	if error:
		push_error(error)
		player = null
		return
	player.play()


func _exit_tree() -> void:
	if player:
		player.close()
	player = null
	force_n = Vector3.ZERO


func _physics_process(delta: float) -> void:
	if not player or not hand:
		return
	var p := to_local(hand.global_position)
	var force := player.advance(Vector3(p.dot(x), p.dot(y), p.dot(z)), delta)
	force_n = global_basis.orthonormalized() * (force.x * x + force.y * y + force.z * z)
