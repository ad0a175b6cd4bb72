"""touchfield"""
