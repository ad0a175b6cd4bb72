"""As rclpy.executors."""


class ExternalShutdownException(Exception):
    """As rclpy's."""
