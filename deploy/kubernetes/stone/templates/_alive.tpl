{{/* The image's health check. It contacts neither database nor broker, so that an outage restarts no worker. A chore of
     the sweeper may take long. */}}
{{- define "stone.alive" -}}
startupProbe:
  exec: { command: [python, -m, services.runtime.processes.health_check] }
  periodSeconds: 10
  timeoutSeconds: 10
  failureThreshold: 30
livenessProbe:
  exec: { command: [python, -m, services.runtime.processes.health_check, {{ ternary "900" "120" (eq .role "beat") | quote }}] }
  periodSeconds: 30
  timeoutSeconds: 10
  failureThreshold: 4
{{- end }}
