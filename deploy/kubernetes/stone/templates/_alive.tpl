{{/* The image's own question, which asks neither database nor broker: an outage of those starts no worker anew. A chore
     of the sweeper may take a while. */}}
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
